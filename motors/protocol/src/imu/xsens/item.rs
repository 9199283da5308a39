//! The items of an MTData2 message.

use crate::imu::error::{SampleError, SampleField};
use crate::imu::sample::{DeviceTime, Quaternion, Sample, finite};

/// Temperature, °C.
pub(super) const TEMPERATURE: u16 = 0x0810;
/// Packet counter.
pub(super) const COUNTER: u16 = 0x1020;
/// Sample time.
pub(super) const TIME: u16 = 0x1060;
/// Quaternion.
pub(super) const QUATERNION: u16 = 0x2010;
/// Acceleration, m/s².
pub(super) const ACCELERATION: u16 = 0x4020;
/// Angular velocity, rad/s.
pub(super) const RATE_OF_TURN: u16 = 0x8020;
/// Status bits.
pub(super) const STATUS: u16 = 0xE020;

/// The bits of an identifier without its format.
const KIND: u16 = 0xFFF0;
const TICKS_PER_SECOND: u32 = 10_000;
/// Bytes of identifier and size.
const HEADER_LEN: usize = 3;

/// 180° about the line between x and y: from NED to ENU.
const ENU_FROM_NED: Quaternion = Quaternion { w: 0.0, x: HALF, y: HALF, z: 0.0 };
/// 90° about z: from NWU to ENU.
const ENU_FROM_NWU: Quaternion = Quaternion { w: HALF, x: 0.0, y: 0.0, z: HALF };
const HALF: f32 = core::f32::consts::FRAC_1_SQRT_2;

/// Decodes the items of a message. Unknown items are skipped. The loop is bounded by the length.
pub(super) fn decode(mut data: &[u8]) -> Result<Sample, SampleError> {
    let mut sample = Sample::default();
    while !data.is_empty() {
        let Some(([high, low, size], rest)) = data.split_first_chunk::<HEADER_LEN>() else {
            return Err(SampleError::Truncated { expected: HEADER_LEN, received: data.len() });
        };
        let size = usize::from(*size);
        let Some((value, rest)) = rest.split_at_checked(size) else {
            return Err(SampleError::Truncated { expected: size, received: rest.len() });
        };
        Item { identifier: u16::from_be_bytes([*high, *low]), value }.store(&mut sample)?;
        data = rest;
    }
    Ok(sample)
}

/// An item of a message.
#[derive(Debug, Clone, Copy)]
struct Item<'a> {
    identifier: u16,
    value: &'a [u8],
}

impl Item<'_> {
    fn store(self, sample: &mut Sample) -> Result<(), SampleError> {
        match self.identifier & KIND {
            COUNTER => sample.counter = Some(u16::from_be_bytes(self.bytes()?)),
            TIME => {
                let ticks = u32::from_be_bytes(self.bytes()?);
                sample.time = Some(DeviceTime { ticks, per_second: TICKS_PER_SECOND });
            }
            STATUS => sample.status = Some(u32::from_be_bytes(self.bytes()?)),
            TEMPERATURE => {
                let [celsius] = finite(SampleField::Temperature, self.numbers()?)?;
                sample.temperature_celsius = Some(celsius);
            }
            ACCELERATION => {
                sample.acceleration = Some(finite(SampleField::Acceleration, self.numbers()?)?);
            }
            RATE_OF_TURN => {
                sample.angular_velocity = Some(finite(SampleField::AngularVelocity, self.numbers()?)?);
            }
            QUATERNION => sample.orientation = Some(self.orientation()?),
            _ => {}
        }
        Ok(())
    }

    /// Returns the value, which has `N` bytes.
    fn bytes<const N: usize>(self) -> Result<[u8; N], SampleError> {
        self.value.try_into().map_err(|_| self.wrong_size(N))
    }

    /// Returns the value as `N` numbers of its precision.
    fn numbers<const N: usize>(self) -> Result<[f32; N], SampleError> {
        let width = [4, 4, 6, 8][usize::from(self.identifier & 3)];
        if self.value.len() != N * width {
            return Err(self.wrong_size(N * width));
        }
        Ok(core::array::from_fn(|index| self.number(&self.value[index * width..][..width]) as f32))
    }

    /// Returns the number with these bytes. Numbers of 6 bytes are fixed point 16.32.
    fn number(self, bytes: &[u8]) -> f64 {
        let is_float = self.identifier & 3 == 0;
        match *bytes {
            [a, b, c, d] if is_float => f32::from_be_bytes([a, b, c, d]).into(),
            [a, b, c, d] => f64::from(i32::from_be_bytes([a, b, c, d])) / f64::from(1 << 20),
            [a, b, c, d, high, low] => {
                let (fraction, integer) = (u32::from_be_bytes([a, b, c, d]), i16::from_be_bytes([high, low]));
                f64::from(integer) + f64::from(fraction) / (1_u64 << 32) as f64
            }
            [a, b, c, d, e, f, g, h] => f64::from_be_bytes([a, b, c, d, e, f, g, h]),
            // `numbers` passes no other width.
            _ => f64::NAN,
        }
    }

    /// Returns the quaternion, from the sensor to ENU.
    fn orientation(self) -> Result<Quaternion, SampleError> {
        let local = Quaternion::new(self.numbers()?)?;
        match self.identifier >> 2 & 3 {
            0 => Ok(local),
            1 => Ok(ENU_FROM_NED.after(local)),
            2 => Ok(ENU_FROM_NWU.after(local)),
            received => Err(SampleError::CoordinateSystem { received: received as u8 }),
        }
    }

    fn wrong_size(self, expected: usize) -> SampleError {
        SampleError::ItemSize { item: self.identifier, expected, received: self.value.len() }
    }
}
