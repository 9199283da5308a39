//! The kernel's bytes for a frame and for its control messages. The bytes come from outside: no
//! function here panics, for any bytes.
//!
//! Source: `linux/can.h` (`struct can_frame`, `struct canfd_frame`, the flags in the id),
//! `linux/socket.h` (control messages).

use crate::clock::RealtimeStamp;
use crate::frame::{Arrival, Content, ErrorFrame, Frame, FrameId, Inbox, Unsupported};
use crate::kernel::{CLASSIC_BYTES, FRAME_BYTES};
use crate::time::Instant;
use core::cell::Cell;

/// The payload of `struct can_frame`.
type Data = [u8; Frame::CLASSIC_LEN_MAX];

/// Offsets in `struct can_frame`.
mod field {
    use core::ops::Range;
    pub(super) const ID: Range<usize> = 0..4;
    pub(super) const LEN: usize = 4;
    /// The raw DLC, where the interface reports it: 9 to 15 when `LEN` is 8.
    pub(super) const LEN8_DLC: usize = 7;
    pub(super) const DATA: Range<usize> = 8..16;
}

/// Returns the bytes to send for a classic frame.
#[inline]
pub(super) fn encode(frame: &Frame) -> [u8; CLASSIC_BYTES] {
    lay_out(frame.id().word(), frame.payload().len() as u8, frame.padded())
}

/// Returns the bytes with which the kernel would report `error`.
pub(super) fn encode_error(error: &ErrorFrame) -> [u8; CLASSIC_BYTES] {
    lay_out(libc::CAN_ERR_FLAG | error.class & libc::CAN_ERR_MASK, 8, error.data)
}

#[inline]
fn lay_out(word: u32, len: u8, data: Data) -> [u8; CLASSIC_BYTES] {
    let mut bytes = [0; CLASSIC_BYTES];
    bytes[field::ID].copy_from_slice(&word.to_ne_bytes());
    bytes[field::LEN] = len;
    bytes[field::DATA].copy_from_slice(&data);
    bytes
}

/// Adds a received message, by its length and its first bytes. `accepts_extended`: a frame with an
/// id of 29 bits is supported. Returns `false` when the inbox is full.
#[inline]
pub(super) fn deliver(
    at: Instant,
    (len, bytes): (usize, [u8; CLASSIC_BYTES]),
    accepts_extended: bool,
    inbox: &mut Inbox,
) -> bool {
    let is_frame = inbox.push_frame(at, |frame| {
        let id = standard_id(&bytes).or_else(|| extended_id(&bytes).filter(|_| accepts_extended));
        id.and_then(|id| data_frame(id, len, &bytes, frame)).is_some()
    });
    is_frame || inbox.push(Arrival { at, content: other_content(len, &bytes) }).is_ok()
}

/// Returns whether the frame is a data frame or a remote frame with an id of 29 bits.
pub(super) fn is_extended(bytes: &[u8; CLASSIC_BYTES]) -> bool {
    word(bytes).is_some_and(|word| word & (libc::CAN_EFF_FLAG | libc::CAN_ERR_FLAG) == libc::CAN_EFF_FLAG)
}

/// Returns an id of 11 bits: no flag is set.
#[inline]
fn standard_id(bytes: &[u8; CLASSIC_BYTES]) -> Option<FrameId> {
    FrameId::new(u16::try_from(word(bytes)?).ok()?)
}

/// Returns the id of a data frame with 29 bits: its flag alone is set.
#[cold]
fn extended_id(bytes: &[u8; CLASSIC_BYTES]) -> Option<FrameId> {
    FrameId::extended(word(bytes)? ^ libc::CAN_EFF_FLAG)
}

/// Writes a data frame.
#[inline]
fn data_frame(id: FrameId, len: usize, bytes: &[u8; CLASSIC_BYTES], frame: &mut Frame) -> Option<()> {
    let is_whole = len == CLASSIC_BYTES && !(9..=15).contains(&bytes[field::LEN8_DLC]);
    let data = *bytes[field::DATA].first_chunk()?;
    (is_whole && frame.set_cut(id, bytes[field::LEN], data)).then_some(())
}

#[cold]
fn other_content(len: usize, bytes: &[u8; CLASSIC_BYTES]) -> Content {
    let flags = word(bytes).filter(|_| len == CLASSIC_BYTES).unwrap_or_default();
    let data = bytes[field::DATA].first_chunk().copied().unwrap_or_default();
    match len {
        _ if flags & libc::CAN_ERR_FLAG != 0 => {
            Content::Error(ErrorFrame { class: flags & libc::CAN_ERR_MASK, data })
        }
        _ if flags & libc::CAN_EFF_FLAG != 0 => Content::Unsupported(Unsupported::Extended),
        _ if flags & libc::CAN_RTR_FLAG != 0 => Content::Unsupported(Unsupported::Remote),
        FRAME_BYTES => Content::Unsupported(Unsupported::Fd),
        _ => Content::Unsupported(Unsupported::Length),
    }
}

/// Returns the id with its flags.
#[inline]
fn word(bytes: &[u8; CLASSIC_BYTES]) -> Option<u32> {
    bytes[field::ID].first_chunk().map(|word| u32::from_ne_bytes(*word))
}

/// Data that the kernel adds to a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Ancillary {
    /// Time at which the frame reached the kernel (`SCM_TIMESTAMPNS`).
    pub(super) stamp: Option<RealtimeStamp>,
    /// Number of frames that this socket had lost when this one was queued, counted from its
    /// opening and wrapping (`SO_RXQ_OVFL`). The kernel omits it while the number is zero.
    pub(super) dropped: Option<u32>,
}

/// Level and kind of the control message with the stamp, and its length: a header of two words, and
/// a `timespec`.
const STAMP: (i32, i32) = (libc::SOL_SOCKET, libc::SO_TIMESTAMPNS);
const STAMP_LEN: u64 = 32;

/// Reads the control messages of one frame. Bounded by the words of the buffer.
#[inline]
pub(super) fn ancillary(control: &[Cell<u64>]) -> Ancillary {
    // Usually the stamp is the only message.
    if let [len, kind, seconds, nanos] = control
        && (len.get(), halves(kind.get())) == (STAMP_LEN, STAMP)
    {
        return Ancillary { stamp: Some(realtime(seconds, nanos)), dropped: None };
    }
    let mut found = Ancillary::default();
    for message in ControlMessages(control) {
        match message.level_and_kind {
            STAMP => {
                found.stamp = message.data.first_chunk().map(|[seconds, nanos]| realtime(seconds, nanos));
            }
            (libc::SOL_SOCKET, libc::SO_RXQ_OVFL) => {
                found.dropped = message.data.first().map(|word| halves(word.get()).0.cast_unsigned());
            }
            _ => {}
        }
    }
    found
}

/// A 64-bit `timespec`.
#[inline]
fn realtime(seconds: &Cell<u64>, nanos: &Cell<u64>) -> RealtimeStamp {
    RealtimeStamp(seconds.get().wrapping_mul(1_000_000_000).wrapping_add(nanos.get()))
}

/// Returns the first four bytes of a word, and the others.
#[inline]
const fn halves(word: u64) -> (i32, i32) {
    let [a, b, c, d, e, f, g, h] = word.to_ne_bytes();
    (i32::from_ne_bytes([a, b, c, d]), i32::from_ne_bytes([e, f, g, h]))
}

struct ControlMessage<'a> {
    level_and_kind: (i32, i32),
    data: &'a [Cell<u64>],
}

/// Iterates over a control buffer. Each message is `struct cmsghdr` (length with header, level,
/// type), its data, and padding to the size of a word.
struct ControlMessages<'a>(&'a [Cell<u64>]);

impl<'a> Iterator for ControlMessages<'a> {
    type Item = ControlMessage<'a>;

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        const WORD: u64 = size_of::<u64>() as u64;
        let [len, kind, rest @ ..] = self.0 else { return None };
        let words = len.get().checked_sub(2 * WORD)?.div_ceil(WORD);
        let (data, others) = rest.split_at_checked(usize::try_from(words).ok()?)?;
        self.0 = others;
        Some(ControlMessage { level_and_kind: halves(kind.get()), data })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns `struct can_frame` in the byte order of the machine: id, length, two of padding, raw
    /// DLC, data.
    fn bytes(word: u32, len: u8, raw_dlc: u8) -> [u8; CLASSIC_BYTES] {
        let [a, b, c, d] = word.to_ne_bytes();
        [a, b, c, d, len, 0, 0, raw_dlc, 1, 2, 3, 4, 5, 6, 7, 8]
    }

    /// Decodes a message of `struct can_frame`.
    fn decode(bytes: [u8; CLASSIC_BYTES]) -> Content {
        decode_of_length(CLASSIC_BYTES, bytes)
    }

    fn decode_of_length(len: usize, bytes: [u8; CLASSIC_BYTES]) -> Content {
        let mut inbox = Inbox::new();
        assert!(deliver(Instant::ZERO, (len, bytes), false, &mut inbox));
        inbox.arrivals()[0].content
    }

    #[test]
    fn frame_survives_passing_through_the_kernel() {
        for len in 0..=8 {
            let frame = Frame::new(FrameId::new(0x101).unwrap(), &[0xA5; 8][..len]).unwrap();
            assert_eq!(decode(encode(&frame)), Content::Frame(frame));
        }
        let extended = Frame::classic(FrameId::extended(0x101).unwrap(), [1, 2]);
        assert_eq!(encode(&extended)[..5], bytes(0x8000_0101, 2, 0)[..5]);
        let mut inbox = Inbox::new();
        assert!(deliver(Instant::ZERO, (CLASSIC_BYTES, encode(&extended)), true, &mut inbox));
        assert_eq!(inbox.arrivals()[0].content, Content::Frame(extended), "where it is expected");
        let frame = Frame::new(FrameId::MAX, &[1, 2, 3, 4, 5, 6]).unwrap();
        assert_eq!(decode(bytes(0x7FF, 6, 0)), Content::Frame(frame), "bytes beyond the length mean nothing");
        let error = ErrorFrame { class: ErrorFrame::CONTROLLER, data: [0, 0x20, 0, 0, 0, 0, 0, 0] };
        assert_eq!(decode(encode_error(&error)), Content::Error(error));
    }

    #[test]
    fn an_unsupported_frame_is_never_a_frame() {
        let of_length = |len, bytes| match decode_of_length(len, bytes) {
            Content::Unsupported(unsupported) => Some(unsupported),
            _ => None,
        };
        let unsupported = |bytes| of_length(CLASSIC_BYTES, bytes);
        assert_eq!(unsupported(bytes(0x8000_0101, 6, 0)), Some(Unsupported::Extended));
        assert_eq!(unsupported(bytes(0x4000_0101, 0, 0)), Some(Unsupported::Remote));
        assert_eq!(of_length(FRAME_BYTES, bytes(0x101, 6, 0)), Some(Unsupported::Fd));
        for raw_dlc in 9..=15 {
            assert_eq!(unsupported(bytes(0x101, 8, raw_dlc)), Some(Unsupported::Length));
        }
        assert_eq!(unsupported(bytes(0x101, 9, 0)), Some(Unsupported::Length));
        assert_eq!(unsupported(bytes(0x101, 255, 0)), Some(Unsupported::Length));
        assert_eq!(
            unsupported(bytes(0x800, 8, 0)),
            Some(Unsupported::Length),
            "twelve bits without the extended flag"
        );
        for short in 0..CLASSIC_BYTES {
            assert_eq!(of_length(short, bytes(0x101, 6, 0)), Some(Unsupported::Length));
        }
    }

    /// `cansend vcan0 20000040#0000000000000000`, the bus-off report of `linux/can/error.h`.
    #[test]
    fn error_report_is_never_a_frame() {
        let mut report = bytes(0x2000_0040, 8, 0);
        report[field::DATA].fill(0);
        assert_eq!(decode(report), Content::Error(ErrorFrame { class: ErrorFrame::BUS_OFF, data: [0; 8] }));
        for flags in [0x2000_0101, 0x6000_0101, 0xA000_0101, 0xE000_0101] {
            assert!(matches!(decode(bytes(flags, 255, 15)), Content::Error(_)));
        }
    }

    fn ancillary(control: &[u8]) -> Ancillary {
        super::ancillary(&words(control))
    }

    /// Returns whole words only, as the kernel's buffer has.
    fn words(bytes: &[u8]) -> Vec<Cell<u64>> {
        bytes.as_chunks().0.iter().map(|word| Cell::new(u64::from_ne_bytes(*word))).collect()
    }

    fn control(kind: i32, data: &[u8]) -> Vec<u8> {
        let mut bytes = (16 + data.len()).to_ne_bytes().to_vec();
        bytes.extend(libc::SOL_SOCKET.to_ne_bytes());
        bytes.extend(kind.to_ne_bytes());
        bytes.extend(data);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    }

    #[test]
    fn stamp_and_loss_are_found_in_any_order() {
        let mut time = [0; 16];
        time[..8].copy_from_slice(&7_u64.to_ne_bytes());
        time[8..].copy_from_slice(&9_u64.to_ne_bytes());
        let parts = [
            control(libc::SO_RXQ_OVFL, &3_u32.to_ne_bytes()),
            control(1, &[0; 5]),
            control(libc::SO_TIMESTAMPNS, &time),
        ];
        let wanted = Ancillary { stamp: Some(RealtimeStamp(7_000_000_009)), dropped: Some(3) };
        assert_eq!(ancillary(&parts.concat()), wanted);
        let reversed: Vec<u8> = parts.iter().rev().flatten().copied().collect();
        assert_eq!(ancillary(&reversed), wanted);
        let alone = control(libc::SO_TIMESTAMPNS, &time);
        assert_eq!(ancillary(&alone), Ancillary { dropped: None, ..wanted });
        for other in [control(1, &time), control(libc::SO_TIMESTAMPNS, &time[..8])] {
            assert_eq!(ancillary(&other), Ancillary::default(), "another message, or no whole stamp");
        }
    }

    #[test]
    fn no_control_bytes_panic_or_overrun() {
        let good = control(libc::SO_TIMESTAMPNS, &[1; 16]);
        for cut in 0..good.len() {
            let _ = ancillary(&good[..cut]);
        }
        for len in [0, 1, 15, 16, 17, usize::MAX - 7, usize::MAX] {
            let mut bad = good.clone();
            bad[..8].copy_from_slice(&len.to_ne_bytes());
            assert!(ControlMessages(&words(&bad)).count() <= bad.len());
        }
    }
}
