//! What a motor tells of its motion, the same three codes in both protocols.

use crate::field::{self, Field};
use crate::scale::{CURRENT, TorqueScale};

/// Position of the output shaft, rad, 16 bits.
pub const POSITION: Field = Field::symmetric(16, 12.5);
/// Velocity of the output shaft, rad/s, 12 bits.
pub const VELOCITY: Field = Field::symmetric(12, 65.0);

/// Position, velocity and torque as the wire has them. Source: MIT document 1.2, GIM document 3.2.7.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct StateCodes {
    /// 16 bits for -12.5 to 12.5 rad.
    pub position: u16,
    /// 12 bits for -65 to 65 rad/s.
    pub velocity: u16,
    /// 12 bits for the torque scale's range.
    pub torque: u16,
}

const STATE: [Field; 3] = [POSITION, VELOCITY, CURRENT];

const _: () = assert!(field::width(&STATE) == 40, "the codes of a state fill five bytes");

impl StateCodes {
    /// Position, rad, velocity, rad/s, and torque, N·m, at the output shaft of a motor with this torque scale.
    #[must_use]
    pub fn scaled(self, scale: &TorqueScale) -> [f32; 3] {
        let values = [
            POSITION.decode(self.position),
            VELOCITY.decode(self.velocity),
            scale.field().decode(self.torque),
        ];
        values.map(|value| value as f32)
    }

    /// The five bytes, big endian, as the MIT reply has them.
    pub(crate) fn pack(self) -> [u8; 5] {
        let word = field::pack(&STATE, [self.position, self.velocity, self.torque]);
        let [_, _, _, bytes @ ..] = word.to_be_bytes();
        bytes
    }

    /// From the five bytes of [`pack`](Self::pack).
    pub(crate) fn unpack(bytes: [u8; 5]) -> Self {
        let [a, b, c, d, e] = bytes;
        let [position, velocity, torque] =
            field::unpack(&STATE, u64::from_be_bytes([0, 0, 0, a, b, c, d, e]));
        Self { position, velocity, torque }
    }
}
