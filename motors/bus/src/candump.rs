//! The log format of can-utils: a line of `candump -L`, such as
//! `(1436509052.249713) vcan0 044#2A366C2BBA`.
//!
//! Source: can-utils, `candump.c` and `lib.h` (`snprintf_canframe`).

use crate::frame::{Content, ErrorFrame, Format, Frame, FrameId, Unsupported};
use crate::time::Duration;

/// `CAN_ERR_FLAG` of `linux/can.h`: this id belongs to an error message frame.
const ERROR_FLAG: u32 = 0x2000_0000;
/// `CAN_ERR_MASK` of `linux/can.h`: the class bits in the id of an error message frame.
const CLASS_MASK: u32 = 0x1FFF_FFFF;

/// One line of a log: a frame, its time and its interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LogLine<'a> {
    /// Time of the frame, since 1970 or since the zero point of `candump -t`.
    pub at: Duration,
    /// The interface of the frame.
    pub interface: &'a str,
    /// The frame.
    pub content: Content,
}

/// Reason for which a line of a CAN log is rejected. The texts hold for every format of logs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum InvalidLine {
    /// Time, interface or frame is missing.
    #[error("no frame of a CAN log: the time, the interface, the id or a data byte is missing")]
    Shape,
    /// The time is not seconds with up to nine decimals, in parentheses.
    #[error("the time of the frame is not a number or date")]
    Time,
    /// The id has neither three hexadecimal digits up to 7FF nor eight.
    #[error("the id is no CAN id: up to 7FF, or up to 1FFFFFFF for an extended one")]
    Id,
    /// The data are not hexadecimal.
    #[error("a data byte is not a number of one byte")]
    Data,
}

impl<'a> LogLine<'a> {
    /// Parses a line, with or without a direction mark (`R`, `T`) at its end.
    ///
    /// # Errors
    ///
    /// The first error in the line. An unsupported frame is [`Content::Unsupported`], not an error.
    pub fn parse(line: &'a str) -> Result<Self, InvalidLine> {
        let mut words = line.split_ascii_whitespace();
        let mut word = || words.next().ok_or(InvalidLine::Shape);
        let (at, interface) = (time(word()?).ok_or(InvalidLine::Time)?, word()?);
        Ok(Self { at, interface, content: content(word()?)? })
    }
}

/// Parses a data frame in the format of a log, `101#0180008008001E00`. `None` for any other text.
#[must_use]
pub fn frame(text: &str) -> Option<Frame> {
    match content(text) {
        Ok(Content::Frame(frame)) => Some(frame),
        _ => None,
    }
}

/// Formats a frame as a line of a log, without its end. Truncates the time to microseconds, as
/// `candump` does.
#[must_use]
pub fn line<'a>(at: Duration, interface: &'a str, frame: &'a Frame) -> impl core::fmt::Display + 'a {
    core::fmt::from_fn(move |f| write!(f, "({}.{:06}) {interface} {frame}", at.as_secs(), at.subsec_micros()))
}

fn time(word: &str) -> Option<Duration> {
    let (seconds, fraction) = word.strip_prefix('(')?.strip_suffix(')')?.split_once('.')?;
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if !digits(seconds) || !digits(fraction) || !(1..=9).contains(&fraction.len()) {
        return None;
    }
    let scale = 10_u32.pow(9 - fraction.len() as u32);
    Some(Duration::new(seconds.parse().ok()?, fraction.parse::<u32>().ok()? * scale))
}

/// Parses an id and the text after its `#`. There, R begins a remote frame, a second # the flags of
/// CAN FD, and `_` a raw DLC.
fn content(text: &str) -> Result<Content, InvalidLine> {
    let (id, data) = text.split_once('#').ok_or(InvalidLine::Shape)?;
    let word = hexadecimal(id).ok_or(InvalidLine::Id)?;
    let id = match id.len() {
        3 => Some(u16::try_from(word).ok().and_then(FrameId::new).ok_or(InvalidLine::Id)?),
        8 => FrameId::extended(word),
        _ => return Err(InvalidLine::Id),
    };
    if data.starts_with('R') {
        return Ok(Content::Unsupported(Unsupported::Remote));
    }
    let (format, data) = format(data)?;
    let (data, raw_dlc) = data.split_once('_').map_or((data, None), |(data, dlc)| (data, Some(dlc)));
    let mut bytes = [0; Frame::LEN_MAX];
    let Some(payload) = unhex(data, &mut bytes)? else {
        return Ok(Content::Unsupported(Unsupported::Length));
    };
    if word & ERROR_FLAG != 0 {
        return Ok(report(word & CLASS_MASK, payload));
    }
    let Some(id) = id else { return Ok(Content::Unsupported(Unsupported::Extended)) };
    let frame = Frame::with_format(id, format, payload).filter(|_| raw_dlc.is_none());
    Ok(frame.map_or(Content::Unsupported(Unsupported::Length), Content::Frame))
}

/// Returns the format of a frame, and the text of its payload. The digit after `##` holds BRS, ESI
/// and further flags, which are ignored.
fn format(data: &str) -> Result<(Format, &str), InvalidLine> {
    let Some(flagged) = data.strip_prefix('#') else { return Ok((Format::Classic, data)) };
    let (digit, payload) = flagged.split_at_checked(1).ok_or(InvalidLine::Data)?;
    let flags = hexadecimal(digit).ok_or(InvalidLine::Data)?;
    let format = Format::Fd { switches_rate: flags & 1 != 0, error_passive: flags & 2 != 0 };
    Ok((format, payload))
}

/// Returns the error message frame of this class and payload; [`Unsupported::Length`] for a payload
/// of more than eight bytes.
#[must_use]
pub fn report(class: u32, payload: &[u8]) -> Content {
    let mut data = [0; 8];
    match data.get_mut(..payload.len()) {
        Some(first) => first.copy_from_slice(payload),
        None => return Content::Unsupported(Unsupported::Length),
    }
    Content::Error(ErrorFrame { class, data })
}

/// Returns the bytes in `digits`; `None` when they exceed the longest frame.
fn unhex<'b>(digits: &str, bytes: &'b mut [u8; Frame::LEN_MAX]) -> Result<Option<&'b [u8]>, InvalidLine> {
    if !digits.len().is_multiple_of(2) || !digits.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return Err(InvalidLine::Data);
    }
    let Some(data) = bytes.get_mut(..digits.len() / 2) else { return Ok(None) };
    for (byte, pair) in data.iter_mut().zip(digits.as_bytes().chunks(2)) {
        let nibble = |digit: u8| char::from(digit).to_digit(16).unwrap_or(0) as u8;
        *byte = nibble(pair[0]) << 4 | nibble(pair[1]);
    }
    Ok(Some(data))
}

/// Unlike `from_str_radix`, accepts no sign.
fn hexadecimal(digits: &str) -> Option<u32> {
    let all_digits = digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    all_digits.then(|| u32::from_str_radix(digits, 16).ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn content_of(frame: &str) -> Result<Content, InvalidLine> {
        LogLine::parse(&format!("(0.0) can0 {frame}")).map(|line| line.content)
    }

    #[test]
    fn log_line_is_read_with_direction_optional() {
        let frame = Frame::new(FrameId::new(0x044).unwrap(), &[0x2A, 0x36]).unwrap();
        let at = Duration::new(1436509052, 249_713_000);
        let expected = LogLine { at, interface: "vcan0", content: Content::Frame(frame) };
        for line in ["(1436509052.249713) vcan0 044#2A36", "(1436509052.249713000)  vcan0  044#2a36 R"] {
            assert_eq!(LogLine::parse(line), Ok(expected));
        }
    }

    #[test]
    fn unsendable_frames_are_read_as_kernel_reports() {
        let error = |class, data| Ok(Content::Error(ErrorFrame { class, data }));
        assert_eq!(content_of("20000040#0000000000000000"), error(ErrorFrame::BUS_OFF, [0; 8]));
        assert_eq!(content_of("20000004#0020"), error(ErrorFrame::CONTROLLER, [0, 0x20, 0, 0, 0, 0, 0, 0]));
        for (frame, unsupported) in [
            ("92345678#00", Unsupported::Extended),
            ("044#R", Unsupported::Remote),
            ("044#R8", Unsupported::Remote),
            ("044##1001122334455667788", Unsupported::Length),
            ("044#0011223344556677_9", Unsupported::Length),
            ("044#001122334455667788", Unsupported::Length),
        ] {
            assert_eq!(content_of(frame), Ok(Content::Unsupported(unsupported)), "{frame}");
        }
    }

    #[test]
    fn fd_frames_and_extended_ids_are_read() {
        let standard = FrameId::new(0x044).unwrap();
        let extended = FrameId::extended(0x1234_5678).unwrap();
        for (text, id, format, payload) in [
            ("12345678#00", extended, Format::Classic, &[0][..]),
            ("044##0", standard, Format::FD, &[]),
            ("044##1AA", standard, Format::FD_BRS, &[0xAA]),
            ("12345678##5AABB", extended, Format::FD_BRS, &[0xAA, 0xBB]),
            (
                "044##300112233445566778899AABB",
                standard,
                Format::Fd { switches_rate: true, error_passive: true },
                &[0, 0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88, 0x99, 0xAA, 0xBB],
            ),
        ] {
            let frame = Frame::with_format(id, format, payload).unwrap();
            assert_eq!(content_of(text), Ok(Content::Frame(frame)), "{text}");
        }
    }

    proptest! {
        #[test]
        fn written_line_is_read_as_same_frame(
            micros in any::<u32>(),
            raw in any::<u32>(),
            is_extended in any::<bool>(),
            flags in 0..=4_u8,
            bytes in any::<[u8; 64]>(),
            len in 0..16_usize,
        ) {
            const LENGTHS: [usize; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64];
            let id = if is_extended { FrameId::extended(raw >> 3) } else { FrameId::new((raw & 0x7FF) as u16) };
            let format = match flags {
                4 => Format::Classic,
                _ => Format::Fd { switches_rate: flags & 1 != 0, error_passive: flags & 2 != 0 },
            };
            let len = if flags == 4 { len.min(8) } else { LENGTHS[len] };
            let frame = Frame::with_format(id.unwrap(), format, &bytes[..len]).unwrap();
            let at = Duration::from_micros(micros.into());
            let text = line(at, "can0", &frame).to_string();
            let expected = LogLine { at, interface: "can0", content: Content::Frame(frame) };
            prop_assert_eq!(super::frame(&frame.to_string()), Some(frame));
            prop_assert_eq!(LogLine::parse(&text), Ok(expected), "{}", text);
        }
    }

    #[test]
    fn malformed_line_is_refused_for_first_mistake() {
        for (line, wrong) in [
            ("", InvalidLine::Shape),
            ("(0.0) can0", InvalidLine::Shape),
            ("(0.0) can0 044", InvalidLine::Shape),
            ("can0 044#", InvalidLine::Time),
            ("(0) can0 044#", InvalidLine::Time),
            ("(-1.0) can0 044#", InvalidLine::Time),
            ("(1.0000000000) can0 044#", InvalidLine::Time),
            ("(99999999999999999999.0) can0 044#", InvalidLine::Time),
            ("(NaN) can0 044#", InvalidLine::Time),
            ("(0.0) can0 04G#", InvalidLine::Id),
            ("(0.0) can0 +44#", InvalidLine::Id),
            ("(0.0) can0 800#", InvalidLine::Id),
            ("(0.0) can0 0044#", InvalidLine::Id),
            ("(0.0) can0 044#2", InvalidLine::Data),
            ("(0.0) can0 044#2é", InvalidLine::Data),
            ("(0.0) can0 044##", InvalidLine::Data),
            ("(0.0) can0 044##é", InvalidLine::Data),
            ("(0.0) can0 044##10", InvalidLine::Data),
        ] {
            assert_eq!(LogLine::parse(line), Err(wrong), "{line}");
        }
    }
}
