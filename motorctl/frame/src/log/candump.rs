//! The forms of `candump`: those of `-L` and `-l`, and the default one with any `-t`, with or
//! without `-x`, `-a` and `-e`.
//!
//! Source: can-utils, `candump.c` and `lib.c` (`snprintf_long_canframe`).

use super::entry::{self, Entry, Source, frame, number};
use motord_bus::candump::{InvalidLine, LogLine, report};
use motord_bus::{Content, Duration, Format, FrameId, Unsupported};
use std::str::SplitAsciiWhitespace;
use time::{Date, Month, Time};

/// `CAN_ERR_FLAG` of `linux/can.h`: this id belongs to an error message frame.
const ERROR_FLAG: u32 = 0x2000_0000;

pub(super) fn parse(line: &str) -> Result<Option<Entry<'_>>, InvalidLine> {
    // The words for the error frame before it (`-e`).
    if line.starts_with('\t') {
        return Ok(None);
    }
    if line.contains('#') {
        let LogLine { at, interface, content } = LogLine::parse(line)?;
        return Ok(Some(Entry { at: Some(at), source: Source::Interface(interface), content }));
    }
    let mut words = line.split_ascii_whitespace();
    let at = if line.trim_start().starts_with('(') { Some(stamp(&mut words)?) } else { None };
    let interface = words.next().ok_or(InvalidLine::Shape)?;
    let content = content(&mut words)?;
    Ok(Some(Entry { at, source: Source::Interface(interface), content }))
}

/// Parses `(seconds.fraction)`, or `(date time)` as of UTC.
fn stamp(words: &mut SplitAsciiWhitespace<'_>) -> Result<Duration, InvalidLine> {
    let first = words.next().and_then(|word| word.strip_prefix('(')).ok_or(InvalidLine::Time)?;
    if let Some(seconds) = first.strip_suffix(')') {
        return entry::time(seconds, 1).ok_or(InvalidLine::Time);
    }
    let second = words.next().and_then(|word| word.strip_suffix(')')).ok_or(InvalidLine::Time)?;
    date(first, second).ok_or(InvalidLine::Time)
}

fn date(date: &str, clock: &str) -> Option<Duration> {
    let (clock, fraction) = clock.split_once('.')?;
    let [year, month, day] = numbers(date, '-')?;
    let [hour, minute, second] = numbers(clock, ':')?;
    let date = Date::from_calendar_date(
        i32::try_from(year).ok()?,
        Month::try_from(u8::try_from(month).ok()?).ok()?,
        u8::try_from(day).ok()?,
    );
    let time = Time::from_hms(hour.try_into().ok()?, minute.try_into().ok()?, second.try_into().ok()?);
    let seconds = date.ok()?.with_time(time.ok()?).assume_utc().unix_timestamp();
    // 0.fraction, which begins with a digit.
    let part = entry::time(&format!("0.{fraction}"), 1)?;
    Some(Duration::from_secs(u64::try_from(seconds).ok()?) + part)
}

fn numbers(text: &str, separator: char) -> Option<[u32; 3]> {
    let mut parts = text.split(separator).map(|part| number(part, 10));
    let numbers = [parts.next()??, parts.next()??, parts.next()??];
    parts.next().is_none().then_some(numbers)
}

/// Parses what follows the interface: `044   [2]  2A 36`, with the marks of `-x` before it.
fn content(words: &mut SplitAsciiWhitespace<'_>) -> Result<Content, InvalidLine> {
    let mut word = || words.next().ok_or(InvalidLine::Shape);
    let (mut id, mut marks) = (word()?, None);
    if ["RX", "TX"].contains(&id) {
        marks = Some((word()? == "B", word()? == "E"));
        id = word()?;
    }
    let length = word()?.strip_prefix('[').and_then(|word| word.strip_suffix(']'));
    let length = length.ok_or(InvalidLine::Shape)?;
    let count = number(length, 10).ok_or(InvalidLine::Shape)? as usize;
    let (switches_rate, error_passive) = marks.unwrap_or_default();
    // Only lengths of CAN FD have two digits.
    let format =
        if length.len() == 1 { Format::Classic } else { Format::Fd { switches_rate, error_passive } };
    let raw = number(id, 16).ok_or(InvalidLine::Id)?;
    let is_report = id.len() == 8 && raw & ERROR_FLAG != 0;
    let id = match id.len() {
        3 => u16::try_from(raw).ok().and_then(FrameId::new),
        8 => FrameId::extended(raw & !ERROR_FLAG),
        _ => None,
    };
    let id = id.ok_or(InvalidLine::Id)?;
    let mut rest = words.peekable();
    if rest.peek() == Some(&"remote") {
        return Ok(Content::Unsupported(Unsupported::Remote));
    }
    let content = frame(id, format, count, rest.by_ref(), 16)?;
    // The text of `-a`, or a mark.
    if rest.peek().is_some_and(|word| !word.starts_with('\'') && *word != "ERRORFRAME") {
        return Err(InvalidLine::Shape);
    }
    Ok(match content {
        Content::Frame(frame) if is_report => report(id.raw(), frame.payload()),
        content => content,
    })
}
