//! The exact length of a frame in bits: ISO 11898-1, with the CRC computed and the stuff bits counted.

use motord_bus::Frame;

/// CRC delimiter, ACK slot, ACK delimiter, 7 bits end of frame, 3 bits interframe space: never stuffed.
const TRAILER_BITS: u32 = 13;
/// Generator of the 15-bit CRC: x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1.
const CRC_POLYNOMIAL: u16 = 0x4599;
const CRC_BITS: u32 = 15;

/// Bits that `frame` occupies on a CAN bus, from its start to the end of the interframe space.
#[must_use]
pub fn frame_bits(frame: &Frame) -> u32 {
    let (content, bits) = content(frame);
    let sequence = content << CRC_BITS | u128::from(crc(content, bits));
    let bits = bits + CRC_BITS;
    bits + stuff_bits(sequence, bits) + TRAILER_BITS
}

/// Start of frame, id, RTR, IDE, r0 (all dominant), DLC and data: what the CRC covers.
fn content(frame: &Frame) -> (u128, u32) {
    let payload = frame.payload();
    let header = u128::from(frame.id().raw()) << 7 | payload.len() as u128;
    let content = payload.iter().fold(header, |word, byte| word << 8 | u128::from(*byte));
    (content, 19 + 8 * payload.len() as u32)
}

fn crc(content: u128, bits: u32) -> u16 {
    (0..bits).rev().fold(0_u16, |crc, bit| {
        let feedback = (content >> bit & 1) as u16 ^ (crc >> (CRC_BITS - 1) & 1);
        ((crc << 1) ^ (feedback * CRC_POLYNOMIAL)) & 0x7FFF
    })
}

/// Five equal bits are followed by a bit of the other value, which is the first of the next five.
fn stuff_bits(sequence: u128, bits: u32) -> u32 {
    let (mut stuffed, mut last, mut run) = (0, 0, 0);
    for bit in (0..bits).rev().map(|place| sequence >> place & 1) {
        run = if bit == last { run + 1 } else { 1 };
        last = bit;
        if run == 5 {
            stuffed += 1;
            last ^= 1;
            run = 1;
        }
    }
    stuffed
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::FrameId;
    use motord_bus::arithmetic::{unstuffed_bits, worst_case_bits};

    fn frame(id: u16, payload: &[u8]) -> Frame {
        Frame::new(FrameId::new(id).unwrap(), payload).unwrap()
    }

    #[test]
    fn crc_matches_a_frame_worked_by_hand() {
        // Id 0, no data: 19 zero bits leave the register at zero.
        assert_eq!(crc(0, 19), 0);
        // The CRC of a single 1 is the polynomial itself. A 0 behind it shifts and reduces that, as in long division.
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

    #[test]
    fn frame_lengths_stay_within_the_formula() {
        let mut random = crate::random::Random::new(1);
        for _ in 0..20_000 {
            let bytes = random.next().to_le_bytes();
            let len = (random.next() % 9) as usize;
            let bits = frame_bits(&frame((random.next() & 0x7FF) as u16, &bytes[..len]));
            let bounds = unstuffed_bits(len as u32)..=worst_case_bits(len as u32);
            assert!(bounds.contains(&bits), "{bits} of {bounds:?}");
        }
    }
}
