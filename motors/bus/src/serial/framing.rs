//! Frames on a serial line, RS485 or RS232: a header of four bytes, then the payload.
//!
//! | byte | meaning |
//! |---|---|
//! | 0 | receiver: the motor's id in a command, the host's in a reply, which does not name its sender |
//! | 1 | type: 0 normal, 1 ACK |
//! | 2 | length of the payload: 8 in a normal frame |
//! | 3 | XOR of the three bytes before |
//!
//! Source: GIM document Table 3, version 2.2. Interpretation:
//! - A motor sends an ACK frame only when it could not read a request. The payload is not
//!   documented: 0 to 8 bytes are accepted.
//! - The payload has no checksum. A damaged one is detected only when it does not match the
//!   request.
//! - There is no start byte and no gap between frames. [`Decoder`] finds the next frame by sliding
//!   one byte at a time.

use core::fmt;

/// Bytes of the header.
pub const HEADER_LEN: usize = 4;
/// Bytes of the longest frame.
pub const FRAME_LEN_MAX: usize = HEADER_LEN + PAYLOAD_LEN;

/// Bytes of the payload of a normal frame.
pub const PAYLOAD_LEN: usize = 8;
const TYPE_NORMAL: u8 = 0;
const TYPE_ACK: u8 = 1;

/// The type of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FrameType {
    /// A command or a reply.
    Normal,
    /// Reports that a request could not be read.
    Ack,
}

/// A frame on a serial line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct SerialFrame {
    receiver: u8,
    frame_type: FrameType,
    len: u8,
    payload: [u8; PAYLOAD_LEN],
}

impl SerialFrame {
    /// Returns a command or a reply for `receiver`.
    #[must_use]
    pub const fn normal(receiver: u8, payload: [u8; PAYLOAD_LEN]) -> Self {
        Self { receiver, frame_type: FrameType::Normal, len: PAYLOAD_LEN as u8, payload }
    }

    /// Returns an ACK for `receiver`; `None` when the payload has more than 8 bytes.
    #[must_use]
    pub fn ack(receiver: u8, payload: &[u8]) -> Option<Self> {
        Header { receiver, frame_type: FrameType::Ack, len: u8::try_from(payload.len()).ok()? }
            .with_payload(payload)
    }

    /// Returns the receiver.
    #[must_use]
    pub const fn receiver(&self) -> u8 {
        self.receiver
    }

    /// Returns the type.
    #[must_use]
    pub const fn frame_type(&self) -> FrameType {
        self.frame_type
    }

    /// Returns the payload: 8 bytes, or up to 8 of an ACK.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        &self.payload[..usize::from(self.len)]
    }

    /// Returns the four bytes of the header.
    #[must_use]
    pub const fn header(&self) -> [u8; HEADER_LEN] {
        let frame_type = match self.frame_type {
            FrameType::Normal => TYPE_NORMAL,
            FrameType::Ack => TYPE_ACK,
        };
        [self.receiver, frame_type, self.len, self.receiver ^ frame_type ^ self.len]
    }

    /// Writes the frame to the start of `buffer` and returns the written bytes.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    pub fn write<'a>(&self, buffer: &'a mut [u8; FRAME_LEN_MAX]) -> &'a [u8] {
        buffer[..HEADER_LEN].copy_from_slice(&self.header());
        buffer[HEADER_LEN..].copy_from_slice(&self.payload);
        &buffer[..HEADER_LEN + usize::from(self.len)]
    }

    /// Decodes `bytes` as exactly one frame.
    ///
    /// # Errors
    ///
    /// When the header is damaged, or the number of bytes differs from that in the header.
    pub fn decode(bytes: &[u8]) -> Result<Self, FrameError> {
        let (header, payload) = bytes
            .split_first_chunk()
            .ok_or(FrameError::Length { expected: HEADER_LEN, received: bytes.len() })?;
        let header = Header::decode(*header)?;
        let expected = HEADER_LEN + usize::from(header.len);
        header.with_payload(payload).ok_or(FrameError::Length { expected, received: bytes.len() })
    }
}

/// A header with a valid checksum.
#[derive(Debug, Clone, Copy)]
struct Header {
    receiver: u8,
    frame_type: FrameType,
    /// At most [`PAYLOAD_LEN`].
    len: u8,
}

impl Header {
    fn decode([receiver, frame_type, len, checksum]: [u8; HEADER_LEN]) -> Result<Self, FrameError> {
        let expected = receiver ^ frame_type ^ len;
        if checksum != expected {
            return Err(FrameError::Checksum { expected, received: checksum });
        }
        let is_payload = usize::from(len) <= PAYLOAD_LEN;
        let frame_type = match frame_type {
            TYPE_NORMAL if usize::from(len) == PAYLOAD_LEN => FrameType::Normal,
            TYPE_ACK if is_payload => FrameType::Ack,
            TYPE_NORMAL | TYPE_ACK => return Err(FrameError::PayloadLength { received: len }),
            received => return Err(FrameError::Type { received }),
        };
        Ok(Self { receiver, frame_type, len })
    }

    fn with_payload(self, bytes: &[u8]) -> Option<SerialFrame> {
        let Self { receiver, frame_type, len } = self;
        let mut payload = [0; PAYLOAD_LEN];
        if bytes.len() != usize::from(len) {
            return None;
        }
        payload.get_mut(..bytes.len())?.copy_from_slice(bytes);
        Some(SerialFrame { receiver, frame_type, len, payload })
    }
}

/// Reason for which bytes are not a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameError {
    /// The bytes are fewer than a header, or their number differs from that in the header.
    Length {
        /// Bytes of the frame, or of a header when it is incomplete.
        expected: usize,
        /// Bytes received.
        received: usize,
    },
    /// The header's last byte is not the XOR of the others.
    Checksum {
        /// XOR of the others.
        expected: u8,
        /// The last byte.
        received: u8,
    },
    /// Neither normal (0) nor ACK (1).
    Type {
        /// The type byte.
        received: u8,
    },
    /// A normal frame without 8 bytes of payload, or an ACK with more than 8.
    PayloadLength {
        /// The length byte.
        received: u8,
    },
}

impl fmt::Display for FrameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Length { expected, received } => {
                write!(f, "the frame has {received} bytes, expected {expected}")
            }
            Self::Checksum { expected, received } => {
                write!(
                    f,
                    "the header ends in {received:#04X}, expected {expected:#04X}, the XOR of its bytes"
                )
            }
            Self::Type { received } => {
                write!(f, "frame type {received:#04X} is neither normal (0) nor ACK (1)")
            }
            Self::PayloadLength { received } => {
                write!(f, "the header says {received} bytes of payload, expected {PAYLOAD_LEN}")
            }
        }
    }
}

impl core::error::Error for FrameError {}

/// Finds frames in a stream of bytes, of which some may be lost, damaged, for other receivers or
/// without a gap.
///
/// The caller decides which frame it accepts. When the bytes look like another frame, the decoder
/// drops one byte at a time, so that no earlier bytes can hide the expected frame.
#[derive(Debug, Clone, Default)]
pub struct Decoder {
    buffer: [u8; FRAME_LEN_MAX],
    len: usize,
    skipped: u32,
}

impl Decoder {
    /// Returns a decoder that has received nothing.
    #[must_use]
    pub const fn new() -> Self {
        Self { buffer: [0; FRAME_LEN_MAX], len: 0, skipped: 0 }
    }

    /// Discards the bytes of an incomplete frame, as before a new request. Returns their number.
    pub fn reset(&mut self) -> usize {
        let forgotten = self.len;
        self.skip(forgotten);
        forgotten
    }

    /// Returns the number of bytes that were part of no accepted frame since the start; wraps
    /// around.
    #[must_use]
    pub const fn skipped(&self) -> u32 {
        self.skipped
    }

    /// Takes the next byte, and returns the frame that it completes and that `accept` accepts.
    ///
    /// Real-time: does not allocate or block; tries at most 12 positions.
    pub fn push(&mut self, byte: u8, accept: impl Fn(&SerialFrame) -> bool) -> Option<SerialFrame> {
        self.buffer[self.len] = byte;
        self.len += 1;
        loop {
            match self.front() {
                Front::Unfinished => return None,
                Front::Frame(frame) if accept(&frame) => {
                    self.remove(HEADER_LEN + usize::from(frame.len));
                    return Some(frame);
                }
                Front::Frame(_) | Front::Damaged => self.skip(1),
            }
        }
    }

    fn front(&self) -> Front {
        let Some((header, rest)) = self.buffer[..self.len].split_first_chunk() else {
            return Front::Unfinished;
        };
        let Ok(header) = Header::decode(*header) else { return Front::Damaged };
        match rest.get(..usize::from(header.len)).and_then(|payload| header.with_payload(payload)) {
            Some(frame) => Front::Frame(frame),
            None => Front::Unfinished,
        }
    }

    fn skip(&mut self, count: usize) {
        self.skipped = self.skipped.wrapping_add(count as u32);
        self.remove(count);
    }

    /// Removes the oldest `count` bytes and moves the others to the front. Afterwards at least one
    /// byte is free: a full buffer always holds a whole frame.
    fn remove(&mut self, count: usize) {
        self.buffer.copy_within(count..self.len, 0);
        self.len -= count;
    }
}

/// State of the beginning of the buffer.
enum Front {
    /// Too few bytes to decide.
    Unfinished,
    /// No header.
    Damaged,
    /// A whole frame.
    Frame(SerialFrame),
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bytes(frame: &SerialFrame) -> ([u8; FRAME_LEN_MAX], usize) {
        let mut buffer = [0; FRAME_LEN_MAX];
        let len = frame.write(&mut buffer).len();
        (buffer, len)
    }

    #[test]
    fn every_truncated_and_oversized_frame_is_refused() {
        let (whole, _) = bytes(&SerialFrame::normal(1, [0x91, 0, 0, 0, 0, 0, 0, 0]));
        let mut long = [0; 32];
        long[..whole.len()].copy_from_slice(&whole);
        for received in (0..12).chain(13..=32) {
            let expected = if received < HEADER_LEN { HEADER_LEN } else { 12 };
            assert_eq!(
                SerialFrame::decode(&long[..received]),
                Err(FrameError::Length { expected, received })
            );
        }
    }

    #[test]
    fn every_header_is_frame_or_first_fault() {
        for (header, refused) in [
            ([1, 0, 8, 8], FrameError::Checksum { expected: 9, received: 8 }),
            ([1, 2, 8, 11], FrameError::Type { received: 2 }),
            ([1, 0, 7, 6], FrameError::PayloadLength { received: 7 }),
            ([1, 0, 0, 1], FrameError::PayloadLength { received: 0 }),
            ([1, 1, 9, 9], FrameError::PayloadLength { received: 9 }),
        ] {
            assert_eq!(SerialFrame::decode(&header), Err(refused));
        }
    }

    #[test]
    fn an_ack_carries_zero_to_eight_bytes() {
        for len in 0..=8 {
            let frame = SerialFrame::ack(3, &[0xEE; 8][..len]).unwrap();
            let (buffer, written) = bytes(&frame);
            assert_eq!(SerialFrame::decode(&buffer[..written]), Ok(frame));
        }
        assert_eq!(SerialFrame::ack(3, &[0; 9]), None);
        assert_eq!(SerialFrame::ack(3, &[0; 300]), None);
    }

    #[test]
    fn frame_with_lost_byte_costs_no_other() {
        let first = SerialFrame::normal(0, [0x93, 0, 0x30, 0x32, 0x73, 0x8E, 0xB8, 0x70]);
        let second = SerialFrame::normal(0, [0xB1, 0, 0, 0, 1, 2, 3, 4]);
        for lost in 0..FRAME_LEN_MAX {
            let mut decoder = Decoder::new();
            let damaged = bytes(&first).0.into_iter().enumerate().filter(|(at, _)| *at != lost);
            let stream = damaged.map(|(_, byte)| byte).chain(bytes(&second).0);
            let found = stream.filter_map(|byte| decoder.push(byte, |frame| *frame == second)).count();
            assert_eq!((found, decoder.skipped()), (1, 11), "byte {lost} lost");
        }
    }

    #[test]
    fn new_request_discards_half_an_old_reply() {
        let frame = SerialFrame::normal(0, [0xB1, 0, 0, 0, 1, 2, 3, 4]);
        let mut decoder = Decoder::new();
        let half = bytes(&frame).0.into_iter().take(7);
        assert_eq!(half.filter_map(|byte| decoder.push(byte, |_| true)).count(), 0);
        decoder.reset();
        let found = bytes(&frame).0.into_iter().filter_map(|byte| decoder.push(byte, |_| true)).last();
        assert_eq!((found, decoder.skipped()), (Some(frame), 7));
    }

    proptest! {
        #[test]
        fn earlier_bytes_never_hide_the_awaited_frame(
            noise in prop::collection::vec(prop_oneof![any::<u8>(), 0..=9_u8], 0..64),
            receiver in any::<u8>(),
            payload in any::<[u8; 8]>(),
        ) {
            let awaited = SerialFrame::normal(receiver, payload);
            let mut decoder = Decoder::new();
            let stream = noise.iter().copied().chain(bytes(&awaited).0);
            let found = stream.map(|byte| decoder.push(byte, |frame| *frame == awaited)).last();
            prop_assert_eq!(found, Some(Some(awaited)));
            prop_assert_eq!(decoder.skipped() as usize, noise.len());
        }

        #[test]
        fn glued_frames_are_decoded_in_order_and_whole(
            frames in prop::collection::vec((any::<u8>(), any::<[u8; 8]>(), prop::option::of(0..=8_usize)), 0..8),
        ) {
            let mut decoder = Decoder::new();
            for (receiver, payload, ack) in frames {
                let frame = match ack {
                    Some(len) => SerialFrame::ack(receiver, &payload[..len]).unwrap(),
                    None => SerialFrame::normal(receiver, payload),
                };
                let (buffer, len) = bytes(&frame);
                let mut found = buffer[..len].iter().filter_map(|&byte| decoder.push(byte, |_| true));
                prop_assert_eq!(found.next(), Some(frame));
                prop_assert_eq!(found.next(), None);
            }
            prop_assert_eq!(decoder.skipped(), 0);
        }
    }
}
