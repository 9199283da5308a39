//! Logs of PEAK's tools (`.trc`), versions 1.0 to 1.3 and 2.x.
//!
//! Source: PEAK CAN TRC File Format, and the logs in python-can's tests.

use super::entry::{self, BUS_ERROR, Entry, Source, frame, number, time};
use motord_bus::candump::InvalidLine;
use motord_bus::{Content, Format, FrameId, Unsupported};
use std::iter::Peekable;

/// Most columns of version 2.
const COLUMNS_MAX: usize = 16;
/// Bits of a status: of bus light or bus heavy, of bus off, of error passive.
const STATUS_WARNING: u32 = 0x0C;
const STATUS_OFF: u32 = 0x10;
const STATUS_PASSIVE: u32 = 0x4_0000;

/// The columns of a log of version 2, one letter each; without any, the log is of version 1.
#[derive(Debug, Default)]
pub(crate) struct Columns {
    letters: [u8; COLUMNS_MAX],
    count: usize,
}

impl Columns {
    /// Reads a line such as `;$COLUMNS=N,O,T,I,d,l,D`.
    fn read(&mut self, line: &str) {
        let Some(list) = line.strip_prefix(";$COLUMNS=") else { return };
        *self = Self::default();
        for (letter, column) in self.letters.iter_mut().zip(list.split(',')) {
            *letter = column.trim().bytes().next().unwrap_or_default();
            self.count += 1;
        }
    }

    /// The columns after number, time and type, up to the data.
    fn middle(&self) -> impl Iterator<Item = u8> {
        self.letters.into_iter().take(self.count).filter(|letter| !b"NOTD".contains(letter))
    }
}

pub(super) fn parse<'a>(line: &'a str, columns: &mut Columns) -> Result<Option<Entry<'a>>, InvalidLine> {
    let line = line.trim();
    if line.starts_with(';') {
        columns.read(line);
        return Ok(None);
    }
    let mut words = line.split_ascii_whitespace().peekable();
    let message = words.next().map(|word| word.strip_suffix(')').unwrap_or(word));
    message.and_then(|digits| number(digits, 10)).ok_or(InvalidLine::Shape)?;
    let at = words.next().and_then(|word| time(word, 1000)).ok_or(InvalidLine::Time)?;
    let (channel, content) =
        if columns.count == 0 { version1(&mut words)? } else { version2(&mut words, columns)? };
    Ok(content.map(|content| Entry { at: Some(at), source: Source::Channel(channel), content }))
}

/// Reads `[bus] [type] id [-] length data`: version 1.0 has neither bus nor type, version 1.1 no
/// bus.
fn version1<'a>(
    words: &mut Peekable<impl Iterator<Item = &'a str> + Clone>,
) -> Result<(u32, Option<Content>), InvalidLine> {
    let is_kind = |word: &&str| ["Rx", "Tx", "Warng", "Error"].contains(word);
    let has_bus = words.clone().nth(1).as_ref().is_some_and(is_kind);
    let bus = words.next_if(|_| has_bus).map(|word| number(word, 10).ok_or(InvalidLine::Shape));
    let kind = words.next_if(is_kind).unwrap_or("Rx");
    let id = words.next().ok_or(InvalidLine::Shape)?;
    let _reserved = words.next_if_eq(&"-");
    let count = words.next().and_then(|word| number(word, 10)).ok_or(InvalidLine::Shape)? as usize;
    let channel = bus.unwrap_or(Ok(1))?;
    let content = match kind {
        "Warng" => status(words.take(count)),
        "Error" => Some(BUS_ERROR),
        _ if words.peek() == Some(&"RTR") => {
            frame_id(id)?;
            Some(Content::Unsupported(Unsupported::Remote))
        }
        _ => Some(frame(frame_id(id)?, Format::Classic, count, words, 16)?),
    };
    Ok((channel, content))
}

/// Reads a line by its columns. Those of a report may be empty, except for its data at the end.
fn version2<'a>(
    words: &mut (impl Iterator<Item = &'a str> + Clone),
    columns: &Columns,
) -> Result<(u32, Option<Content>), InvalidLine> {
    let kind = words.next().ok_or(InvalidLine::Shape)?;
    let has_bus = columns.middle().next() == Some(b'B');
    let channel = if has_bus { words.clone().next().and_then(|word| number(word, 10)) } else { Some(1) };
    let channel = channel.ok_or(InvalidLine::Shape)?;
    let format = match kind {
        "DT" | "RR" => Format::Classic,
        "FD" => Format::FD,
        "FB" => Format::FD_BRS,
        "FE" => Format::Fd { switches_rate: false, error_passive: true },
        "BI" => Format::Fd { switches_rate: true, error_passive: true },
        "ST" => return Ok((channel, status(words.skip_while(|word| *word != "Rx")))),
        "ER" => return Ok((channel, Some(BUS_ERROR))),
        // Counters and events of the user.
        _ => return Ok((channel, None)),
    };
    let (mut id, mut length) = (None, None);
    for letter in columns.middle() {
        let word = words.next().ok_or(InvalidLine::Shape)?;
        match letter {
            b'I' => id = Some(frame_id(word)?),
            b'l' | b'L' => length = number(word, 10),
            _ => {}
        }
    }
    let id = id.ok_or(InvalidLine::Id)?;
    if kind == "RR" {
        return Ok((channel, Some(Content::Unsupported(Unsupported::Remote))));
    }
    let count = words.clone().count();
    // A length of CAN FD may be a code.
    if format == Format::Classic && length != u32::try_from(count).ok() {
        return Err(InvalidLine::Shape);
    }
    frame(id, format, count, words, 16).map(|content| (channel, Some(content)))
}

/// Reads the status in the last four bytes of `words`. `None` for a healthy controller.
fn status<'a>(words: impl Iterator<Item = &'a str>) -> Option<Content> {
    let bytes = words.filter(|word| word.len() == 2).filter_map(|word| number(word, 16));
    let status = bytes.fold(0, |status: u32, byte| status << 8 | byte);
    let has = |bits: u32| status & bits != 0;
    entry::status(has(STATUS_OFF), has(STATUS_PASSIVE), has(STATUS_WARNING))
}

/// Parses an id: 4 digits for 11 bits, 8 for 29.
fn frame_id(word: &str) -> Result<FrameId, InvalidLine> {
    let raw = number(word, 16).ok_or(InvalidLine::Id)?;
    let id = match word.len() {
        4 => u16::try_from(raw).ok().and_then(FrameId::new),
        8 => FrameId::extended(raw),
        _ => None,
    };
    id.ok_or(InvalidLine::Id)
}
