//! CANopen: a transmit PDO (TPDO) for each quantity, sent without a request.
//!
//! | id | bytes | content | scale |
//! |---|---|---|---|
//! | 0x180 + node | 6 | acceleration x, y, z | 0.001 G |
//! | 0x280 + node | 6 | angular velocity x, y, z | 0.1 °/s |
//! | 0x380 + node | 6 | roll, pitch, yaw | 0.01 ° |
//! | 0x480 + node | 8 | quaternion w, x, y, z | 0.0001 |
//!
//! All are `i16`, little endian. The default is node 8 at 500 kbit/s, each TPDO at 100 Hz, from 10
//! to 200 Hz. The device sends them after power-on, or after
//! [`command::start`](super::command::start). Source: user manual, CAN protocol; SDK,
//! `canopen_parser.c` and `CANopen.dbc`. The angular velocity saturates at 3276.7 °/s, the
//! acceleration at 32.767 G.
//!
//! The TPDOs have neither a time nor a number. [`Decoder`] combines them by order and time of
//! arrival. All TPDOs of a sample must have the same rate.

use super::{DEGREE, GRAVITY};
use crate::imu::error::SampleError;
use crate::imu::request::CanRequest;
use crate::imu::sample::{Quaternion, Sample};
use crate::imu::sequence::Measured;
use crate::imu::sequence::{Parts, Sequence};

/// Largest node that a CANopen device can have.
pub const NODE_MAX: u8 = 127;
/// Node of a new device.
pub const NODE_DEFAULT: u8 = 8;

/// The TPDOs of a sample, and that of the angles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Tpdo {
    /// TPDO1.
    Acceleration,
    /// TPDO2.
    AngularVelocity,
    /// TPDO3.
    Angles,
    /// TPDO4.
    Orientation,
}

impl Tpdo {
    /// Every TPDO that this module decodes.
    pub const ALL: [Self; 4] = [Self::Acceleration, Self::AngularVelocity, Self::Angles, Self::Orientation];

    /// Returns the id for `node`, of which seven bits count.
    #[must_use]
    pub const fn id(self, node: u8) -> u16 {
        let base = match self {
            Self::Acceleration => 0x180,
            Self::AngularVelocity => 0x280,
            Self::Angles => 0x380,
            Self::Orientation => 0x480,
        };
        base | (node & NODE_MAX) as u16
    }

    /// Returns the index of the TPDO, from 0.
    pub(super) const fn index(self) -> u8 {
        match self {
            Self::Acceleration => 0,
            Self::AngularVelocity => 1,
            Self::Angles => 2,
            Self::Orientation => 3,
        }
    }

    /// Decodes the payload.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    ///
    /// # Errors
    ///
    /// The payload has another length than the TPDO in the user manual, or the quaternion is no
    /// rotation.
    pub fn decode(self, payload: &[u8]) -> Result<Measured, SampleError> {
        Ok(match self {
            Self::Acceleration => Measured::Acceleration(scaled(payload, 0.001 * GRAVITY)?),
            Self::AngularVelocity => Measured::AngularVelocity(scaled(payload, 0.1 * DEGREE)?),
            Self::Angles => Measured::Angles(scaled(payload, 0.01 * DEGREE)?),
            Self::Orientation => Measured::Orientation(Quaternion::new(scaled(payload, 0.0001)?)?),
        })
    }
}

/// Returns the `N` numbers of a payload, times `scale`.
fn scaled<const N: usize>(payload: &[u8], scale: f32) -> Result<[f32; N], SampleError> {
    if payload.len() != 2 * N {
        return Err(SampleError::Length { least: 2 * N, most: 2 * N, received: payload.len() });
    }
    let code = |index: usize| i16::from_le_bytes([payload[2 * index], payload[2 * index + 1]]);
    Ok(core::array::from_fn(|index| f32::from(code(index)) * scale))
}

/// Encodes a quantity as the device `node` would, for simulated devices and tests. Values saturate.
#[must_use]
pub fn encode(node: u8, measured: &Measured) -> CanRequest {
    match *measured {
        Measured::Acceleration(value) => frame(Tpdo::Acceleration.id(node), codes(value, 0.001 * GRAVITY)),
        Measured::AngularVelocity(value) => frame(Tpdo::AngularVelocity.id(node), codes(value, 0.1 * DEGREE)),
        Measured::Angles(value) => frame(Tpdo::Angles.id(node), codes(value, 0.01 * DEGREE)),
        Measured::Orientation(value) => {
            let [w, x, y, z] = codes(value.parts(), 0.0001);
            let [[a, b], [c, d], [e, f], [g, h]] = [w, x, y, z].map(i16::to_le_bytes);
            CanRequest::new(Tpdo::Orientation.id(node), [a, b, c, d, e, f, g, h])
        }
    }
}

fn frame(id: u16, codes: [i16; 3]) -> CanRequest {
    let [[a, b], [c, d], [e, f]] = codes.map(i16::to_le_bytes);
    CanRequest::new(id, [a, b, c, d, e, f])
}

/// Returns the nearest codes. The cast saturates.
fn codes<const N: usize>(values: [f32; N], scale: f32) -> [i16; N] {
    values.map(|value| {
        let code = value / scale;
        (if code < 0.0 { code - 0.5 } else { code + 0.5 }) as i16
    })
}

/// Combines the TPDOs of one device into samples.
#[derive(Debug, Clone)]
pub struct Decoder {
    node: u8,
    sequence: Sequence,
}

impl Decoder {
    /// Returns a decoder for the samples of `node` with these `parts`. The frames of a sample
    /// arrive within `within_us`, µs: half of the period of the TPDOs.
    #[must_use]
    pub fn new(node: u8, parts: Parts, within_us: u64) -> Self {
        Self { node: node & NODE_MAX, sequence: Sequence::new(parts, within_us) }
    }

    /// Drops the sample that is being received: the next frames belong to another one.
    pub const fn drop_sample(&mut self) {
        self.sequence.drop_sample();
    }

    /// Takes a frame that arrived at `at_us`, by any clock. Returns the sample that it completes.
    /// Frames with other ids are ignored.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    ///
    /// # Errors
    ///
    /// The payload is no TPDO, or a frame of the sample is lost: see [`SampleError::Incomplete`].
    /// The sample is dropped, and reported once.
    pub fn push(&mut self, id: u16, payload: &[u8], at_us: u64) -> Result<Option<Sample>, SampleError> {
        let Some(tpdo) = Tpdo::ALL.into_iter().find(|tpdo| tpdo.id(self.node) == id) else {
            return Ok(None);
        };
        match tpdo.decode(payload) {
            Ok(measured) => self.sequence.push(measured, at_us),
            Err(error) => {
                self.sequence.drop_sample();
                Err(error)
            }
        }
    }
}
