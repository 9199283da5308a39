//! The codes of position, velocity and torque, which every reply with a state contains.

use crate::field::{self, TWELVE_BITS};
use crate::scale::Scales;

/// Position, velocity and torque as codes. Source: MIT document 1.2, GIM document 3.2.7.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct StateCodes {
    /// 16 bits, see [`Scales::position`].
    pub position: u16,
    /// 12 bits, see [`Scales::velocity`].
    pub velocity: u16,
    /// 12 bits, see [`Scales::torque`].
    pub torque: u16,
}

/// Bits of position, velocity and torque: five bytes.
const WIDTHS: [u32; 3] = [16, 12, 12];

impl StateCodes {
    /// Returns position, rad, velocity, rad/s, and torque, N·m, at the output shaft of a motor with
    /// these scales.
    #[must_use]
    #[inline]
    pub fn scaled(self, scales: &Scales) -> [f32; 3] {
        let values = [
            scales.position.decode_within(self.position),
            scales.velocity.decode_within(self.velocity.min(TWELVE_BITS)),
            scales.torque.decode_within(self.torque.min(TWELVE_BITS)),
        ];
        values.map(|value| value as f32)
    }

    /// Returns the five bytes, big endian, in the layout of an MIT reply.
    pub(crate) fn pack(self) -> [u8; 5] {
        let word = field::pack(WIDTHS, [self.position, self.velocity, self.torque]);
        let [_, _, _, bytes @ ..] = word.to_be_bytes();
        bytes
    }

    /// Reads the five bytes of [`pack`](Self::pack).
    #[inline]
    pub(crate) fn unpack(bytes: [u8; 5]) -> Self {
        let [a, b, c, d, e] = bytes;
        let others = u32::from_be_bytes([b, c, d, e]);
        Self {
            position: u16::from_be_bytes([a, b]),
            velocity: (others >> 12) as u16 & TWELVE_BITS,
            torque: others as u16 & TWELVE_BITS,
        }
    }
}
