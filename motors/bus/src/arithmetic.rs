//! Lengths of frames in bits, and the share of a cycle that a bus needs.
//!
//! Bits of a frame, without stuff bits and with the interframe space:
//!
//! | field | classic | CAN FD |
//! |---|---|---|
//! | start of frame to r0, or to BRS: 11-bit id, 29-bit id | 15, 35 | 17, 36 |
//! | ESI | | 1, at the data bit rate |
//! | DLC and payload of s bytes | 4 + 8s | 4 + 8s, at the data bit rate |
//! | stuff count, CRC and their fixed stuff bits | 15 | 27 up to 16 bytes, otherwise 32, at the data bit rate |
//! | CRC delimiter | 1 | 1, at the data bit rate |
//! | ACK to interframe space | 12 | 12 |
//!
//! A stuff bit follows at most 5 equal bits, and at most every 4 bits after that. A classic frame
//! stuffs the bits up to the CRC, a CAN FD frame those up to the payload. In CAN FD, the first
//! fixed stuff bit replaces a stuff bit after the payload.
//!
//! Sources: Davis, Burns, Bril, Lukkien, "Controller Area Network (CAN) schedulability analysis:
//! refuted, revisited and revised" (2007); ISO 11898-1:2015, 10.4.2 and 10.5.

use crate::frame::Format;
use crate::time::Duration;

/// The width of an arbitration id.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IdWidth {
    /// 11 bits.
    Standard,
    /// 29 bits.
    Extended,
}

/// Bits of a classic frame from the DLC to the end, without the payload: those that are stuffed,
/// and those that are not.
const CLASSIC_END: (u32, u32) = (4 + 15, 13);
/// Bits of any frame from the ACK slot to the end of the interframe space.
const END: u32 = 12;

/// Bits of a classic data frame with `bytes` of payload without stuff bits, including the
/// interframe space.
#[must_use]
pub const fn unstuffed_bits(width: IdWidth, bytes: u32) -> u32 {
    stuffable_bits(width, bytes) + CLASSIC_END.1
}

/// Bits of the same frame with the largest possible number of stuff bits.
#[must_use]
pub const fn worst_case_bits(width: IdWidth, bytes: u32) -> u32 {
    unstuffed_bits(width, bytes) + (stuffable_bits(width, bytes) - 1) / 4
}

/// Expected bits of the same frame, with ¾ of the possible stuff bits. Frames of a motor at rest
/// have long runs of equal bits, and at most 17 of 24 stuff bits. Those of a moving motor have
/// fewer.
#[must_use]
pub const fn expected_bits(width: IdWidth, bytes: u32) -> u32 {
    unstuffed_bits(width, bytes) + (worst_case_bits(width, bytes) - unstuffed_bits(width, bytes)) * 3 / 4
}

const fn stuffable_bits(width: IdWidth, bytes: u32) -> u32 {
    let header = match width {
        IdWidth::Standard => 15,
        IdWidth::Extended => 35,
    };
    header + CLASSIC_END.0 + 8 * bytes
}

/// Bits of a frame, including the interframe space, by the bit rate at which they are sent. Those
/// of a classic frame are all nominal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FdBits {
    /// At the bit rate of arbitration.
    pub nominal: u32,
    /// At the data bit rate, if the frame switches to it (BRS).
    pub data: u32,
}

impl FdBits {
    /// Returns the bits of a frame with `bytes` of payload, with only the fixed stuff bits of its
    /// CRC.
    #[must_use]
    pub const fn unstuffed(width: IdWidth, bytes: u32) -> Self {
        let crc = if bytes <= 16 { 4 + 17 + 6 } else { 4 + 21 + 7 };
        Self { nominal: Self::header(width) + END, data: Self::content(bytes) + crc + 1 }
    }

    /// Returns the bits of the same frame with the largest possible number of stuff bits,
    /// preferably at the nominal bit rate.
    #[must_use]
    pub const fn worst_case(width: IdWidth, bytes: u32) -> Self {
        let Self { nominal, data } = Self::unstuffed(width, bytes);
        let header = Self::header(width);
        let stuff_bits = (header + Self::content(bytes) - 2) / 4;
        let in_header = (header - 1) / 4;
        Self { nominal: nominal + in_header, data: data + stuff_bits - in_header }
    }

    /// Returns the bits at the bit rate of arbitration that take as long, rounded up.
    #[must_use]
    pub const fn at(self, bitrate: u32, data_bitrate: u32) -> u32 {
        self.nominal + (self.data as u64 * bitrate as u64).div_ceil(data_bitrate as u64) as u32
    }

    /// Returns the time of the frame, rounded up to a nanosecond. A frame without BRS has one bit
    /// rate for both parts.
    #[must_use]
    pub const fn wire_time(self, bitrate: u32, data_bitrate: u32) -> Duration {
        wire_time(self.nominal, bitrate).saturating_add(wire_time(self.data, data_bitrate))
    }

    /// Start of frame to BRS.
    const fn header(width: IdWidth) -> u32 {
        match width {
            IdWidth::Standard => 17,
            IdWidth::Extended => 36,
        }
    }

    /// ESI, DLC and payload.
    const fn content(bytes: u32) -> u32 {
        1 + 4 + 8 * bytes
    }
}

/// The length of a data frame: everything that decides its bits besides their values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameLength {
    /// Of its id.
    pub width: IdWidth,
    /// Classic, or CAN FD.
    pub format: Format,
    /// Of its payload.
    pub bytes: u32,
}

impl FrameLength {
    /// A classic frame with an id of 11 bits.
    #[must_use]
    pub const fn classic(bytes: u32) -> Self {
        Self { width: IdWidth::Standard, format: Format::Classic, bytes }
    }

    /// Returns its bits without stuff bits; in CAN FD with the fixed ones.
    #[must_use]
    pub const fn unstuffed(self) -> FdBits {
        match self.format {
            Format::Classic => FdBits { nominal: unstuffed_bits(self.width, self.bytes), data: 0 },
            Format::Fd { .. } => FdBits::unstuffed(self.width, self.bytes),
        }
    }

    /// Returns its bits with the most stuff bits.
    #[must_use]
    pub const fn worst_case(self) -> FdBits {
        match self.format {
            Format::Classic => FdBits { nominal: worst_case_bits(self.width, self.bytes), data: 0 },
            Format::Fd { .. } => FdBits::worst_case(self.width, self.bytes),
        }
    }

    /// Returns its bits with ¾ of the possible stuff bits, as [`expected_bits`] does.
    #[must_use]
    pub const fn expected(self) -> FdBits {
        let (least, most) = (self.unstuffed(), self.worst_case());
        FdBits {
            nominal: least.nominal + (most.nominal - least.nominal) * 3 / 4,
            data: least.data + (most.data - least.data) * 3 / 4,
        }
    }
}

/// Bits of one native frame on RS485 or RS232: 4 bytes of header, 8 of payload, 10 bits a byte
/// (8N1). Source: GIM document, tables 1 and 3.
pub const SERIAL_FRAME_BITS: u32 = (4 + 8) * 10;

/// Returns the time that `bits` take at `bitrate` bit/s, rounded up to a nanosecond.
#[must_use]
pub const fn wire_time(bits: u32, bitrate: u32) -> Duration {
    Duration::from_nanos((bits as u64 * 1_000_000_000).div_ceil(bitrate as u64))
}

/// Returns the fraction of a bus that `bits` per cycle occupy. 1.0 is a bus without a gap.
#[must_use]
pub fn utilisation(bits: u32, rate_hz: f64, bitrate: u32) -> f64 {
    f64::from(bits) * rate_hz / f64::from(bitrate)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bits of a command with 8 bytes and its reply, without and with stuff bits.
    const fn transaction(reply: u32) -> (u32, u32) {
        let [command, reply] = [FrameLength::classic(8), FrameLength::classic(reply)];
        (
            command.unstuffed().nominal + reply.unstuffed().nominal,
            command.worst_case().nominal + reply.worst_case().nominal,
        )
    }

    #[test]
    fn frame_lengths_are_those_of_the_published_formula() {
        let classic = |width, bytes| (unstuffed_bits(width, bytes), worst_case_bits(width, bytes));
        assert_eq!(classic(IdWidth::Standard, 8), (111, 135));
        assert_eq!(classic(IdWidth::Standard, 6), (95, 115));
        // 54 + 64 bits are stuffed, 13 are not: 131, and (118 - 1) / 4 = 29 stuff bits.
        assert_eq!(classic(IdWidth::Extended, 8), (131, 160));
        // 54 stuffed and 13 others: 67, and 53 / 4 = 13 stuff bits.
        assert_eq!(classic(IdWidth::Extended, 0), (67, 80));
        assert_eq!(transaction(6), (206, 250));
        assert_eq!(transaction(8), (222, 270));
    }

    #[test]
    fn fd_lengths_are_those_worked_by_hand() {
        let fd = |width, bytes| {
            let [least, most] = [FdBits::unstuffed(width, bytes), FdBits::worst_case(width, bytes)];
            [least.nominal, least.data, most.nominal, most.data]
        };
        // Header 17, end 12. Data: 1 + 4 + 0 payload + 27 + 1 = 33. Of 22 bits, (22 - 2) / 4 = 5
        // get a stuff bit, 4 in the header.
        assert_eq!(fd(IdWidth::Standard, 0), [29, 33, 33, 34]);
        // Data: 1 + 4 + 64 + 27 + 1 = 97. Of 86 bits, 84 / 4 = 21 stuff bits, 4 and 17.
        assert_eq!(fd(IdWidth::Standard, 8), [29, 97, 33, 114]);
        // The last length with CRC-17. Data: 1 + 4 + 128 + 27 + 1 = 161. Of 150 bits, 148 / 4 = 37,
        // 4 and 33.
        assert_eq!(fd(IdWidth::Standard, 16), [29, 161, 33, 194]);
        // CRC-21. Data: 1 + 4 + 160 + 32 + 1 = 198. Of 182 bits, 180 / 4 = 45, 4 and 41.
        assert_eq!(fd(IdWidth::Standard, 20), [29, 198, 33, 239]);
        // Data: 1 + 4 + 512 + 32 + 1 = 550. Of 534 bits, 532 / 4 = 133, 4 and 129.
        assert_eq!(fd(IdWidth::Standard, 64), [29, 550, 33, 679]);
        // Header 36. Of 36 + 517 = 553 bits, 551 / 4 = 137, 8 in the header and 129.
        assert_eq!(fd(IdWidth::Extended, 64), [48, 550, 56, 679]);
        // 33 µs at 1 Mbit/s, and 679 bits of 200 ns.
        let longest = FdBits::worst_case(IdWidth::Standard, 64);
        assert_eq!(longest.wire_time(1_000_000, 5_000_000), Duration::from_nanos(33_000 + 135_800));
        assert_eq!(longest.at(1_000_000, 5_000_000), 33 + 136);
    }

    #[test]
    fn three_motors_at_1_khz_use_three_quarters() {
        let (unstuffed, worst) = transaction(6);
        let [unstuffed, worst] = [unstuffed, worst].map(|bits| utilisation(3 * bits, 1000.0, 1_000_000));
        assert!((worst - 0.75).abs() < 1e-12 && (unstuffed - 0.618).abs() < 1e-12);
    }

    #[test]
    fn frame_on_rs485_lasts_130_microseconds() {
        assert_eq!(wire_time(SERIAL_FRAME_BITS, 921_600), Duration::from_nanos(130_209));
    }
}
