//! The exact length of a frame in bits: ISO 11898-1, with the CRC computed and the stuff bits
//! counted.

use motord_bus::arithmetic::{FdBits, IdWidth, wire_time};
use motord_bus::{Duration, Format, Frame, FrameId};

/// CRC delimiter, ACK slot, ACK delimiter, 7 bits end of frame, 3 bits interframe space: never
/// stuffed.
const TRAILER_BITS: u32 = 13;
/// Generator of the 15-bit CRC: x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1.
const CRC_POLYNOMIAL: u16 = 0x4599;
const CRC_BITS: u32 = 15;

/// Returns the time of `frame` on a CAN bus with these bit rates in bit/s, from its start to the
/// end of the interframe space.
pub(crate) fn frame_time(frame: &Frame, bitrate: u32, data_bitrate: u32) -> Duration {
    match frame.format() {
        Format::Classic => wire_time(frame_bits(frame), bitrate),
        Format::Fd { switches_rate, error_passive } => {
            let data_bitrate = if switches_rate { data_bitrate } else { bitrate };
            fd_bits(frame, switches_rate, error_passive).wire_time(bitrate, data_bitrate)
        }
    }
}

/// Returns the bits of a classic `frame` on a CAN bus, from its start to the end of the interframe
/// space.
#[must_use]
pub fn frame_bits(frame: &Frame) -> u32 {
    let mut sequence = Sequence::default();
    sequence.put_id(frame.id());
    // r0, which follows r1 in an extended frame.
    sequence.put(0, if frame.id().is_extended() { 2 } else { 1 });
    sequence.put(frame.payload().len() as u32, 4);
    sequence.put_payload(frame);
    sequence.put(sequence.crc.into(), CRC_BITS);
    sequence.bits + sequence.stuff_bits + TRAILER_BITS
}

/// Returns the bits of a CAN FD `frame`, by their bit rate. A stuff bit after BRS counts as one of
/// the nominal bit rate.
fn fd_bits(frame: &Frame, switches_rate: bool, error_passive: bool) -> FdBits {
    let mut sequence = Sequence::default();
    sequence.put_id(frame.id());
    // FDF, res, BRS.
    sequence.put(0b100 | u32::from(switches_rate), 3);
    let in_header = sequence.stuff_bits;
    sequence.put(error_passive.into(), 1);
    sequence.put(data_length_code(frame.payload().len()), 4);
    sequence.put_payload(frame);
    // The first fixed stuff bit replaces a stuff bit after the payload.
    let in_content = sequence.stuff_bits - in_header - u32::from(sequence.ends_in_stuff_bit);
    let width = if frame.id().is_extended() { IdWidth::Extended } else { IdWidth::Standard };
    let FdBits { nominal, data } = FdBits::unstuffed(width, frame.payload().len() as u32);
    FdBits { nominal: nominal + in_header, data: data + in_content }
}

const fn data_length_code(len: usize) -> u32 {
    match len {
        0..=8 => len as u32,
        9..=12 => 9,
        13..=16 => 10,
        17..=20 => 11,
        21..=24 => 12,
        25..=32 => 13,
        33..=48 => 14,
        _ => 15,
    }
}

/// The bits of a frame from its start, and the CRC and the stuff bits that result from them.
#[derive(Debug, Default)]
struct Sequence {
    bits: u32,
    crc: u16,
    stuff_bits: u32,
    ends_in_stuff_bit: bool,
    last: u32,
    run: u32,
}

impl Sequence {
    /// Appends start of frame, the id with SRR and IDE, and RTR or RRS; for a standard frame also
    /// IDE.
    fn put_id(&mut self, id: FrameId) {
        let raw = id.raw();
        self.put(0, 1);
        if id.is_extended() {
            self.put(raw >> 18, 11);
            self.put(0b11, 2);
            self.put(raw & 0x3_FFFF, 18);
            self.put(0, 1);
        } else {
            self.put(raw, 11);
            self.put(0b00, 2);
        }
    }

    fn put_payload(&mut self, frame: &Frame) {
        frame.payload().iter().for_each(|byte| self.put((*byte).into(), 8));
    }

    /// Appends the lower `count` bits of `word`, the highest first.
    fn put(&mut self, word: u32, count: u32) {
        (0..count).rev().for_each(|shift| self.put_bit(word >> shift & 1));
    }

    /// Appends a bit. Five equal bits are followed by a bit of the other value, which is the first
    /// of the next five.
    fn put_bit(&mut self, bit: u32) {
        let feedback = bit as u16 ^ (self.crc >> (CRC_BITS - 1) & 1);
        self.crc = ((self.crc << 1) ^ (feedback * CRC_POLYNOMIAL)) & 0x7FFF;
        self.bits += 1;
        self.run = if bit == self.last { self.run + 1 } else { 1 };
        self.last = bit;
        self.ends_in_stuff_bit = self.run == 5;
        if self.ends_in_stuff_bit {
            self.stuff_bits += 1;
            self.last ^= 1;
            self.run = 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::arithmetic::{unstuffed_bits, worst_case_bits};

    fn frame(id: u16, payload: &[u8]) -> Frame {
        Frame::new(FrameId::new(id).unwrap(), payload).unwrap()
    }

    fn sequence(word: u32, bits: u32) -> Sequence {
        let mut sequence = Sequence::default();
        sequence.put(word, bits);
        sequence
    }

    fn crc(word: u32, bits: u32) -> u16 {
        sequence(word, bits).crc
    }

    fn stuff_bits(word: u32, bits: u32) -> u32 {
        sequence(word, bits).stuff_bits
    }

    #[test]
    fn crc_matches_a_frame_worked_by_hand() {
        // Id 0, no data: 19 zero bits leave the register at zero.
        assert_eq!(crc(0, 19), 0);
        // The CRC of a single 1 is the polynomial itself. A 0 after it shifts and reduces the CRC,
        // as in long division.
        assert_eq!(crc(1, 1), 0x4599);
        assert_eq!(crc(0b10, 2), ((0x4599 << 1) ^ 0x4599) & 0x7FFF);
    }

    #[test]
    fn stuff_bits_follow_five_equal_bits() {
        assert_eq!(stuff_bits(0, 4), 0);
        assert_eq!(stuff_bits(0, 5), 1);
        // 00000 1 1111: the stuffed one and four more make the next five.
        assert_eq!(stuff_bits(0x00F, 9), 2);
        assert_eq!(stuff_bits(0x2AA, 10), 0);
    }

    #[test]
    fn well_known_frames_have_their_published_lengths() {
        assert_eq!(frame_bits(&frame(1, &[0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC])), 125);
        assert_eq!(frame_bits(&frame(1, &[0x7F, 0xFF, 0x7F, 0xF0, 0, 0, 0x07, 0xFF])), 126);
        assert_eq!(frame_bits(&frame(1, &[0; 8])), 128);
    }

    /// Id 0, no data, no BRS: 14 zeros get 2 stuff bits, and 4 zeros are left. After FDF, the 1,
    /// follow res, BRS, ESI and four zeros of the DLC: the fifth of these 7 zeros gets a stuff bit.
    #[test]
    fn fd_frame_has_the_length_worked_by_hand() {
        let empty = Frame::with_format(FrameId::from(0), Format::FD, &[]).unwrap();
        assert_eq!(fd_bits(&empty, false, false), FdBits { nominal: 29 + 2, data: 33 + 1 });
        assert_eq!(frame_time(&empty, 1_000_000, 5_000_000), Duration::from_micros(31 + 34));
        let switching = Frame::with_format(FrameId::from(0), Format::FD_BRS, &[]).unwrap();
        // ESI and DLC are five zeros after BRS: the first fixed stuff bit replaces theirs.
        assert_eq!(fd_bits(&switching, true, false), FdBits { nominal: 29 + 2, data: 33 });
        assert_eq!(frame_time(&switching, 1_000_000, 5_000_000), Duration::from_nanos(31_000 + 33 * 200));
    }

    #[test]
    fn frame_lengths_stay_within_the_formula() {
        const LENGTHS: [usize; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64];
        let mut random = crate::random::Random::new(1);
        for _ in 0..20_000 {
            let raw = random.next();
            let (id, width) = match raw & 1 {
                0 => (FrameId::new((raw >> 8 & 0x7FF) as u16), IdWidth::Standard),
                _ => (FrameId::extended((raw >> 8 & 0x1FFF_FFFF) as u32), IdWidth::Extended),
            };
            let word = if raw & 2 == 0 { 0 } else { random.next() };
            let bytes: Vec<u8> = word.to_le_bytes().repeat(8);
            let len = LENGTHS[(random.next() % 16) as usize];
            if let Some(classic) = Frame::new(id.unwrap(), &bytes[..len]) {
                let bits = frame_bits(&classic);
                let bounds = unstuffed_bits(width, len as u32)..=worst_case_bits(width, len as u32);
                assert!(bounds.contains(&bits), "{bits} of {bounds:?}");
            }
            let fd = Frame::with_format(id.unwrap(), Format::FD_BRS, &bytes[..len]).unwrap();
            let bits = fd_bits(&fd, true, raw & 4 == 0);
            let [least, most] = [FdBits::unstuffed(width, len as u32), FdBits::worst_case(width, len as u32)];
            assert!((least.nominal..=most.nominal).contains(&bits.nominal), "{bits:?}");
            let all = |bits: FdBits| bits.nominal + bits.data;
            assert!((all(least)..=all(most)).contains(&all(bits)), "{bits:?}");
        }
    }

    /// The bounds are reached: alternating runs of four equal bits get a stuff bit every four bits.
    #[test]
    fn the_worst_case_of_a_frame_is_possible() {
        let pattern = sequence(0b0000_0111_1000_0111_1000_0111_1000_0111, 32);
        assert_eq!((pattern.stuff_bits, (32 - 1) / 4), (7, 7));
    }
}
