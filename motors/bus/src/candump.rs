//! The log format of can-utils: a line of `candump -L`, such as `(1436509052.249713) vcan0 044#2A366C2BBA`.
//!
//! Source: can-utils, `candump.c` and `lib.h` (`snprintf_canframe`).

use crate::frame::{Content, ErrorFrame, Frame, FrameId, Unsupported};
use crate::time::Duration;

/// `CAN_ERR_FLAG` of `linux/can.h`: this id belongs to an error message frame.
const ERROR_FLAG: u32 = 0x2000_0000;
/// `CAN_ERR_MASK` of `linux/can.h`: the class bits in the id of an error message frame.
const CLASS_MASK: u32 = 0x1FFF_FFFF;

/// One line of a log: a frame, its time and its interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LogLine<'a> {
    /// Time of the frame, since 1970 or since the zero that `candump -t` chose.
    pub at: Duration,
    /// Its interface.
    pub interface: &'a str,
    /// The frame.
    pub content: Content,
}

/// Why a line is not a line of such a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum InvalidLine {
    /// Time, interface or frame is missing.
    #[error("not a line of 'candump -L', which is (time) interface id#data")]
    Shape,
    /// The time is not seconds with up to nine decimals, in parentheses.
    #[error("the time is not (seconds.fraction)")]
    Time,
    /// The id has neither three hexadecimal digits up to 7FF nor eight.
    #[error("the id is not three hexadecimal digits up to 7FF, nor eight")]
    Id,
    /// The data are not hexadecimal.
    #[error("the data are not hexadecimal, two digits a byte")]
    Data,
}

impl<'a> LogLine<'a> {
    /// Reads a line, with or without a direction mark (`R`, `T`) at its end.
    ///
    /// # Errors
    ///
    /// The first mistake in the line. An unsupported frame is [`Content::Unsupported`], not an error.
    pub fn parse(line: &'a str) -> Result<Self, InvalidLine> {
        let mut words = line.split_ascii_whitespace();
        let mut word = || words.next().ok_or(InvalidLine::Shape);
        let (at, interface) = (time(word()?).ok_or(InvalidLine::Time)?, word()?);
        let (id, data) = word()?.split_once('#').ok_or(InvalidLine::Shape)?;
        Ok(Self { at, interface, content: content(id, data)? })
    }
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

/// The frame of `id` and of the text behind `#`. There, R begins a remote frame, a second # the flags of CAN FD, and `_` a
/// raw DLC.
fn content(id: &str, data: &str) -> Result<Content, InvalidLine> {
    let word = hexadecimal(id).ok_or(InvalidLine::Id)?;
    let standard = match id.len() {
        3 => Some(u16::try_from(word).ok().and_then(FrameId::new).ok_or(InvalidLine::Id)?),
        8 => None,
        _ => return Err(InvalidLine::Id),
    };
    if data.starts_with('R') {
        return Ok(Content::Unsupported(Unsupported::Remote));
    }
    if data.starts_with('#') {
        return Ok(Content::Unsupported(Unsupported::Fd));
    }
    let (data, raw_dlc) = data.split_once('_').map_or((data, None), |(data, dlc)| (data, Some(dlc)));
    let Some((bytes, len)) = bytes(data)? else { return Ok(Content::Unsupported(Unsupported::Length)) };
    if word & ERROR_FLAG != 0 {
        return Ok(Content::Error(ErrorFrame { class: word & CLASS_MASK, data: bytes }));
    }
    Ok(match standard.map(|id| Frame::new(id, &bytes[..len])) {
        None => Content::Unsupported(Unsupported::Extended),
        Some(Some(frame)) if raw_dlc.is_none() => Content::Frame(frame),
        Some(_) => Content::Unsupported(Unsupported::Length),
    })
}

/// The bytes in `digits` and their number; `None` when they are more than a classic frame holds.
fn bytes(digits: &str) -> Result<Option<([u8; 8], usize)>, InvalidLine> {
    if !digits.len().is_multiple_of(2) || !digits.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return Err(InvalidLine::Data);
    }
    let mut bytes = [0; 8];
    let len = digits.len() / 2;
    let Some(data) = bytes.get_mut(..len) else { return Ok(None) };
    for (byte, pair) in data.iter_mut().zip(digits.as_bytes().chunks(2)) {
        let nibble = |digit: u8| char::from(digit).to_digit(16).unwrap_or(0) as u8;
        *byte = nibble(pair[0]) << 4 | nibble(pair[1]);
    }
    Ok(Some((bytes, len)))
}

/// Unlike `from_str_radix`, takes no sign.
fn hexadecimal(digits: &str) -> Option<u32> {
    let all_digits = digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    all_digits.then(|| u32::from_str_radix(digits, 16).ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

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
            ("12345678#00", Unsupported::Extended),
            ("044#R", Unsupported::Remote),
            ("044#R8", Unsupported::Remote),
            ("044##100", Unsupported::Fd),
            ("044#0011223344556677_9", Unsupported::Length),
            ("044#001122334455667788", Unsupported::Length),
        ] {
            assert_eq!(content_of(frame), Ok(Content::Unsupported(unsupported)), "{frame}");
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
        ] {
            assert_eq!(LogLine::parse(line), Err(wrong), "{line}");
        }
    }
}
