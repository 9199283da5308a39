//! Lengths of frames in bits, and the part of a cycle that a bus needs.
//!
//! Source: Davis, Burns, Bril, Lukkien, "Controller Area Network (CAN) schedulability analysis: refuted, revisited and
//! revised" (2007): a standard data frame with s bytes has 34 + 8s bits that are subject to stuffing (start of frame,
//! id, control, data, CRC) and 13 that are not, the 3-bit interframe space included.

use crate::time::Duration;

/// Bits of a standard data frame with `bytes` of payload without stuff bits, including the interframe space.
#[must_use]
pub const fn unstuffed_bits(bytes: u32) -> u32 {
    47 + 8 * bytes
}

/// Bits of the same frame with the most stuff bits that are possible.
#[must_use]
pub const fn worst_case_bits(bytes: u32) -> u32 {
    unstuffed_bits(bytes) + (34 + 8 * bytes - 1) / 4
}

/// One command and its reply, by their payload lengths in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Transaction {
    /// Payload of the command.
    pub command: u32,
    /// Payload of the reply.
    pub reply: u32,
}

impl Transaction {
    /// Bits on a CAN bus without stuff bits.
    #[must_use]
    pub const fn unstuffed_bits(self) -> u32 {
        unstuffed_bits(self.command) + unstuffed_bits(self.reply)
    }

    /// Bits on a CAN bus with the most stuff bits.
    #[must_use]
    pub const fn worst_case_bits(self) -> u32 {
        worst_case_bits(self.command) + worst_case_bits(self.reply)
    }
}

/// Bits of one native frame on RS485 or RS232: 4 bytes of header, 8 of payload, 10 bits a byte (8N1).
/// Source: GIM document, tables 1 and 3.
pub const SERIAL_FRAME_BITS: u32 = (4 + 8) * 10;

/// The time that `bits` take at `bitrate` bit/s, rounded up to a nanosecond.
#[must_use]
pub const fn wire_time(bits: u32, bitrate: u32) -> Duration {
    Duration::from_nanos((bits as u64 * 1_000_000_000).div_ceil(bitrate as u64))
}

/// The fraction of a bus that `bits` per cycle occupy: 1.0 is a bus without a gap.
#[must_use]
pub fn utilisation(bits: u32, rate_hz: f64, bitrate: u32) -> f64 {
    f64::from(bits) * rate_hz / f64::from(bitrate)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As with a motor in MIT mode.
    const SHORT_REPLY: Transaction = Transaction { command: 8, reply: 6 };
    const LONG_REPLY: Transaction = Transaction { command: 8, reply: 8 };

    #[test]
    fn frame_lengths_are_those_of_the_published_formula() {
        assert_eq!((unstuffed_bits(8), worst_case_bits(8)), (111, 135));
        assert_eq!((unstuffed_bits(6), worst_case_bits(6)), (95, 115));
        assert_eq!((SHORT_REPLY.unstuffed_bits(), SHORT_REPLY.worst_case_bits()), (206, 250));
        assert_eq!((LONG_REPLY.unstuffed_bits(), LONG_REPLY.worst_case_bits()), (222, 270));
    }

    #[test]
    fn three_motors_at_1_khz_use_three_quarters() {
        let worst = utilisation(3 * SHORT_REPLY.worst_case_bits(), 1000.0, 1_000_000);
        let unstuffed = utilisation(3 * SHORT_REPLY.unstuffed_bits(), 1000.0, 1_000_000);
        assert!((worst - 0.75).abs() < 1e-12 && (unstuffed - 0.618).abs() < 1e-12);
    }

    #[test]
    fn a_frame_on_rs485_takes_130_microseconds() {
        assert_eq!(wire_time(SERIAL_FRAME_BITS, 921_600), Duration::from_nanos(130_209));
    }
}
