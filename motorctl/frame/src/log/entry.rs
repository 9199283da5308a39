//! A frame or a report of a log, and the parts of a line.

use motord_bus::candump::InvalidLine;
use motord_bus::{Content, Duration, ErrorFrame, Format, Frame, FrameId, Unsupported};

/// The details of `ErrorFrame::CONTROLLER` in byte 1, of either direction: an error counter above
/// 96, and above 127.
const WARNING: u8 = 0x0C;
const PASSIVE: u8 = 0x30;

/// A frame or a report of a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Entry<'a> {
    /// Time as the log has it: since 1970, or since the start of the recording.
    pub(crate) at: Option<Duration>,
    pub(crate) source: Source<'a>,
    pub(crate) content: Content,
}

/// The bus of an entry, as its log names it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Source<'a> {
    /// The name of the interface.
    Interface(&'a str),
    /// The number of a channel, from 1 on.
    Channel(u32),
}

/// Parses a frame from its id and its bytes, each a word of hexadecimal (or, for `radix` 10,
/// decimal) digits. Reads `count` words.
pub(super) fn frame<'a>(
    id: FrameId,
    format: Format,
    count: usize,
    words: impl Iterator<Item = &'a str>,
    radix: u32,
) -> Result<Content, InvalidLine> {
    let mut bytes = [0; Frame::LEN_MAX];
    let mut read = 0;
    let Some(data) = bytes.get_mut(..count) else { return Ok(Content::Unsupported(Unsupported::Length)) };
    for (byte, word) in data.iter_mut().zip(words) {
        *byte = number(word, radix).and_then(|byte| u8::try_from(byte).ok()).ok_or(InvalidLine::Data)?;
        read += 1;
    }
    if read < count {
        return Err(InvalidLine::Shape);
    }
    let frame = Frame::with_format(id, format, data);
    Ok(frame.map_or(Content::Unsupported(Unsupported::Length), Content::Frame))
}

/// The report of an error on the bus.
pub(super) const BUS_ERROR: Content = report(ErrorFrame::BUS_ERROR, 0);

/// Returns the report of a controller that is off, error passive or at its warning limit; the worst
/// counts. `None` for a healthy one.
pub(super) const fn status(is_off: bool, is_passive: bool, is_warning: bool) -> Option<Content> {
    match (is_off, is_passive, is_warning) {
        (true, ..) => Some(report(ErrorFrame::BUS_OFF, 0)),
        (_, true, _) => Some(report(ErrorFrame::CONTROLLER, PASSIVE)),
        (_, _, true) => Some(report(ErrorFrame::CONTROLLER, WARNING)),
        _ => None,
    }
}

const fn report(class: u32, detail: u8) -> Content {
    Content::Error(ErrorFrame { class, data: [0, detail, 0, 0, 0, 0, 0, 0] })
}

/// Parses digits without a sign.
pub(super) fn number(digits: &str, radix: u32) -> Option<u32> {
    let is_number = !digits.is_empty() && digits.chars().all(|digit| digit.is_digit(radix));
    is_number.then(|| u32::from_str_radix(digits, radix).ok()).flatten()
}

/// Parses a decimal number of units, of which `per_second` are a second. `None` for any other text.
pub(super) fn time(word: &str, per_second: u64) -> Option<Duration> {
    let (whole, fraction) = word.split_once('.').unwrap_or((word, ""));
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if whole.is_empty() || !digits(whole) || !digits(fraction) || fraction.len() > 9 {
        return None;
    }
    let nanos = 1_000_000_000 / per_second;
    let part = fraction
        .bytes()
        .fold((0, nanos), |(sum, weight), digit| (sum + u64::from(digit - b'0') * weight / 10, weight / 10));
    let whole: u64 = whole.parse().ok()?;
    Some(Duration::from_nanos(whole.checked_mul(nanos)?.checked_add(part.0)?))
}
