//! 0x91 frames on a serial line.
//!
//! | byte | meaning |
//! |---|---|
//! | 0, 1 | 0x5A, 0xA5 |
//! | 2, 3 | length of the payload: 76 for one packet 0x91 |
//! | 4, 5 | CRC-16 of bytes 0 to 3 and of the payload: polynomial 0x1021, initial value 0 |
//! | 6 | 0x91 |
//! | 7, 8 | status bits |
//! | 9 | temperature, °C, signed |
//! | 10 | pressure, Pa, float |
//! | 14 | time since power-on, ms, `u32`; UTC after synchronisation with GNSS |
//! | 18 | acceleration x, y, z, G, floats |
//! | 30 | angular velocity x, y, z, °/s, floats |
//! | 42 | magnetic field x, y, z, µT, floats |
//! | 54 | roll, pitch, yaw, °, floats |
//! | 66 | quaternion w, x, y, z, floats |
//!
//! All numbers are little endian. Source: user manual, binary serial protocol; SDK, `hipnuc_dec.c`.
//!
//! A frame can carry several packets, each with its tag first. The decoder passes over packets 0x81
//! (104 bytes) before the one 0x91, and ignores what follows it. It names an intact frame without a
//! 0x91 that it finds so: the lengths of other packets, such as 0x83, depend on settings of the
//! device.

use super::{DEGREE, GRAVITY};
use crate::imu::error::{SampleError, SampleField};
use crate::imu::sample::{DeviceTime, Quaternion, Sample, finite};
use crate::imu::window::{Begun, Window};

/// Bytes of a frame with one packet 0x91.
pub const FRAME_LEN: usize = HEADER_LEN + PAYLOAD_LEN;
/// Bytes of the longest frame: twice that of the vendor's decoder (`HIPNUC_MAX_RAW_SIZE`).
const FRAME_LEN_MAX: usize = 512;

const HEADER_LEN: usize = 6;
const PAYLOAD_LEN: usize = 76;
/// The bytes before the checksum.
const START: [u8; 4] = [0x5A, 0xA5, PAYLOAD_LEN as u8, 0];
const TAG: u8 = 0x91;
/// The packet with the position of a satellite receiver, and its length (`hi81_t`).
const INS_TAG: u8 = 0x81;
const INS_LEN: usize = 104;
const TICKS_PER_SECOND: u32 = 1000;

/// Finds samples in a stream of bytes.
#[derive(Debug, Clone, Default)]
pub struct Decoder {
    window: Window<{ 2 * FRAME_LEN_MAX }>,
    /// The frame of any length that has begun.
    begun: Option<Begun>,
}

impl Decoder {
    /// Returns a decoder that has received nothing.
    #[must_use]
    pub const fn new() -> Self {
        Self { window: Window::new(), begun: None }
    }

    /// Takes the next byte. Returns the sample that it completes, or the reason for which the frame
    /// that it completes is none.
    ///
    /// Real-time: does not allocate or block; checks at most one frame of 82 bytes and one of 512.
    pub fn push(&mut self, byte: u8) -> Option<Result<Sample, SampleError>> {
        self.window.push(byte);
        let decoded = self.any_frame();
        let decoded = self.one_packet().or(decoded);
        // Bytes of a damaged frame can be the beginning of an intact one.
        if matches!(decoded, Some(Ok(_))) {
            self.window.clear();
            self.begun = None;
        }
        decoded
    }

    /// Returns the sample of a frame with one packet 0x91 that ends with the last byte.
    fn one_packet(&self) -> Option<Result<Sample, SampleError>> {
        let frame = self.window.last(FRAME_LEN)?;
        let is_one = frame[..START.len()] == START && frame[HEADER_LEN] == TAG;
        is_one.then(|| check(frame).and_then(|()| sample(&frame[HEADER_LEN..])))
    }

    /// Follows one frame of any length at a time. Returns what an intact one holds: bytes between
    /// frames look like damaged ones.
    fn any_frame(&mut self) -> Option<Result<Sample, SampleError>> {
        if self.begun.is_none() {
            let header = self.window.last(HEADER_LEN)?;
            let len = HEADER_LEN + usize::from(u16::from_le_bytes([header[2], header[3]]));
            let is_header = header[..2] == START[..2] && (HEADER_LEN + 1..=FRAME_LEN_MAX).contains(&len);
            self.begun = is_header.then_some(Begun::new(len, len - HEADER_LEN));
            return None;
        }
        let frame = self.window.last(Begun::count(&mut self.begun)?)?;
        check(frame).ok()?;
        Some(packets(&frame[HEADER_LEN..]))
    }
}

/// Checks the checksum of a frame.
fn check(frame: &[u8]) -> Result<(), SampleError> {
    let (expected, received) = (checksum(frame), u16::from_le_bytes([frame[4], frame[5]]));
    if expected == received { Ok(()) } else { Err(SampleError::Checksum { expected, received }) }
}

/// Returns the sample of the packet 0x91 of a payload.
fn packets(mut payload: &[u8]) -> Result<Sample, SampleError> {
    while payload.first() == Some(&INS_TAG) {
        payload = payload.get(INS_LEN..).unwrap_or_default();
    }
    match payload.first() {
        Some(&TAG) if payload.len() >= PAYLOAD_LEN => sample(payload),
        tag => Err(SampleError::OtherPacket { received: tag.copied().unwrap_or(INS_TAG) }),
    }
}

/// Decodes a packet 0x91, which has [`PAYLOAD_LEN`] bytes or more.
fn sample(packet: &[u8]) -> Result<Sample, SampleError> {
    let acceleration = finite(SampleField::Acceleration, floats(packet, 12).map(|value| value * GRAVITY))?;
    let velocity = finite(SampleField::AngularVelocity, floats(packet, 24).map(|value| value * DEGREE))?;
    let ticks = u32::from_le_bytes(at(packet, 8));
    Ok(Sample {
        orientation: Some(Quaternion::new(floats(packet, 60))?),
        angular_velocity: Some(velocity),
        acceleration: Some(acceleration),
        temperature_celsius: Some(f32::from(i8::from_le_bytes(at(packet, 3)))),
        time: Some(DeviceTime { ticks, per_second: TICKS_PER_SECOND }),
        counter: None,
        status: Some(u16::from_le_bytes(at(packet, 1)).into()),
    })
}

/// Encodes a sample as a device would, for simulated devices and tests. A value that is `None` is
/// zero; an orientation is the identity. Pressure, magnetic field and angles are zero.
#[must_use]
pub fn encode(sample: &Sample) -> [u8; FRAME_LEN] {
    let mut frame = [0; FRAME_LEN];
    frame[..START.len()].copy_from_slice(&START);
    frame[HEADER_LEN] = TAG;
    frame[7..9].copy_from_slice(&(sample.status.unwrap_or_default() as u16).to_le_bytes());
    frame[9] = (sample.temperature_celsius.unwrap_or_default() as i8).to_le_bytes()[0];
    frame[14..18].copy_from_slice(&sample.time.map_or(0, |time| time.ticks).to_le_bytes());
    let acceleration = sample.acceleration.unwrap_or_default().map(|value| value / GRAVITY);
    let velocity = sample.angular_velocity.unwrap_or_default().map(|value| value / DEGREE);
    let orientation = sample.orientation.map_or([1.0, 0.0, 0.0, 0.0], Quaternion::parts);
    write(&mut frame, 18, acceleration);
    write(&mut frame, 30, velocity);
    write(&mut frame, 66, orientation);
    let checksum = checksum(&frame).to_le_bytes();
    frame[4..HEADER_LEN].copy_from_slice(&checksum);
    frame
}

/// Returns the checksum of a frame.
fn checksum(frame: &[u8]) -> u16 {
    let covered = frame[..START.len()].iter().chain(&frame[HEADER_LEN..]);
    covered.fold(0, |crc, byte| {
        let crc = crc ^ u16::from(*byte) << 8;
        (0..8).fold(crc, |crc, _| if crc & 0x8000 == 0 { crc << 1 } else { crc << 1 ^ 0x1021 })
    })
}

/// Returns the bytes at `start`.
fn at<const N: usize>(packet: &[u8], start: usize) -> [u8; N] {
    core::array::from_fn(|index| packet[start + index])
}

/// Returns the floats at `start`.
fn floats<const N: usize>(packet: &[u8], start: usize) -> [f32; N] {
    core::array::from_fn(|index| f32::from_le_bytes(at(packet, start + 4 * index)))
}

fn write<const N: usize>(frame: &mut [u8; FRAME_LEN], start: usize, values: [f32; N]) {
    for (index, value) in values.into_iter().enumerate() {
        frame[start + 4 * index..][..4].copy_from_slice(&value.to_le_bytes());
    }
}
