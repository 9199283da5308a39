//! Logs of Vector's tools (`.asc`).
//!
//! Source: the logs of several tools, among them those in python-can's tests. Lines that are no CAN
//! frame, no error frame and no status are skipped.

use super::entry::{self, BUS_ERROR, Entry, Source, frame, number, time};
use motord_bus::candump::InvalidLine;
use motord_bus::{Content, Duration, Format, Frame, FrameId, Unsupported};

/// Bits of the flags of a frame: CAN FD, and remote.
const FLAG_FD: u32 = 0x1000;
const FLAG_REMOTE: u32 = 0x10;
/// Words between the data of a CAN FD line and its flags: duration and length.
const WORDS_BEFORE_FLAGS: usize = 2;

/// The lines before the frames.
#[derive(Debug)]
pub(crate) struct Header {
    /// The base of ids and bytes.
    radix: u32,
    /// The time of the last line, if times count from there.
    last: Option<Duration>,
}

impl Default for Header {
    fn default() -> Self {
        Self { radix: 16, last: None }
    }
}

impl Header {
    /// Reads a line such as `base hex  timestamps absolute`.
    fn read(&mut self, line: &str) {
        let mut words = line.split_ascii_whitespace();
        while let Some(word) = words.next() {
            match (word, words.clone().next()) {
                ("base", Some("dec")) => self.radix = 10,
                ("base", Some("hex")) => self.radix = 16,
                ("timestamps", Some("relative")) => self.last = Some(Duration::ZERO),
                ("timestamps", Some("absolute")) => self.last = None,
                _ => {}
            }
        }
    }

    fn at(&mut self, stamp: Duration) -> Duration {
        match &mut self.last {
            Some(last) => {
                *last = last.saturating_add(stamp);
                *last
            }
            None => stamp,
        }
    }
}

pub(super) fn parse<'a>(line: &'a str, header: &mut Header) -> Result<Option<Entry<'a>>, InvalidLine> {
    let mut words = line.split_ascii_whitespace();
    let Some(stamp) = words.next().and_then(|word| time(word, 1)) else {
        header.read(line);
        return Ok(None);
    };
    let at = header.at(stamp);
    let first = words.next().unwrap_or_default();
    let is_of_kind = ["CANFD", "CAN"].contains(&first);
    let channel = if is_of_kind { words.next().unwrap_or_default() } else { first };
    let Some(channel) = number(channel, 10) else { return Ok(None) };
    let content = match first {
        "CANFD" => fd(&mut words, header.radix)?,
        "CAN" => status(line),
        _ => classic(&mut words, header.radix)?,
    };
    Ok(content.map(|content| Entry { at: Some(at), source: Source::Channel(channel), content }))
}

/// Reads `CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0`. An active controller is
/// healthy.
fn status(line: &str) -> Option<Content> {
    let (_, status) = line.split_once("Status:")?;
    let status = status.to_ascii_lowercase();
    let has = |word: &str| status.contains(word);
    entry::status(has("busoff") || has("bus off"), has("passive"), has("warning"))
}

/// Reads what follows the channel: `6F9 Rx d 3 05 0C 00`. `None` for a line of another kind.
fn classic<'a>(
    words: &mut impl Iterator<Item = &'a str>,
    radix: u32,
) -> Result<Option<Content>, InvalidLine> {
    let id = words.next().unwrap_or_default();
    if id == "ErrorFrame" {
        return Ok(Some(BUS_ERROR));
    }
    let is_frame = ["Rx", "Tx"].contains(&words.next().unwrap_or_default());
    match words.next() {
        Some("r") if is_frame => {
            frame_id(id, radix)?;
            Ok(Some(Content::Unsupported(Unsupported::Remote)))
        }
        Some("d") if is_frame => {
            let length = words.next().and_then(|word| number(word, 16)).ok_or(InvalidLine::Shape)?;
            // Raw codes of 9 to 15 mean 8 bytes.
            let count = length.min(Frame::CLASSIC_LEN_MAX as u32) as usize;
            frame(frame_id(id, radix)?, Format::Classic, count, words, radix).map(Some)
        }
        _ => Ok(None),
    }
}

/// Reads what follows the channel of a CAN FD line: direction, id, possibly a name, BRS, ESI, DLC,
/// length, data, duration, length, flags.
fn fd<'a>(
    words: &mut (impl Iterator<Item = &'a str> + Clone),
    radix: u32,
) -> Result<Option<Content>, InvalidLine> {
    let mut word = || words.next().ok_or(InvalidLine::Shape);
    let (direction, id) = (word()?, word()?);
    if direction == "ErrorFrame" || id == "ErrorFrame" {
        return Ok(Some(BUS_ERROR));
    }
    let bit = |word: &str| number(word, 2).filter(|_| word.len() == 1).map(|bit| bit == 1);
    let mut brs = word()?;
    if bit(brs).is_none() {
        brs = word()?;
    }
    let (switches_rate, error_passive) = bit(brs).zip(bit(word()?)).ok_or(InvalidLine::Shape)?;
    let _dlc = word()?;
    let count = number(word()?, 10).ok_or(InvalidLine::Shape)? as usize;
    let flags = words.clone().nth(count.saturating_add(WORDS_BEFORE_FLAGS)).and_then(|word| number(word, 16));
    if flags.is_some_and(|flags| flags & FLAG_REMOTE != 0) {
        return Ok(Some(Content::Unsupported(Unsupported::Remote)));
    }
    let is_classic = flags.is_some_and(|flags| flags & FLAG_FD == 0) && count <= Frame::CLASSIC_LEN_MAX;
    let format = if is_classic { Format::Classic } else { Format::Fd { switches_rate, error_passive } };
    frame(frame_id(id, radix)?, format, count, words, radix).map(Some)
}

/// Parses an id; one of 29 bits ends with an x.
fn frame_id(word: &str, radix: u32) -> Result<FrameId, InvalidLine> {
    let id = match word.strip_suffix('x') {
        Some(digits) => number(digits, radix).and_then(FrameId::extended),
        None => number(word, radix).and_then(|raw| u16::try_from(raw).ok()).and_then(FrameId::new),
    };
    id.ok_or(InvalidLine::Id)
}
