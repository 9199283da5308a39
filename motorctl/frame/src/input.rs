//! The inputs of `decode`: arguments, files and standard input, each a log, or frames in
//! hexadecimal.

use crate::codec::Codec;
use crate::hex;
use crate::log::{Entry, Log, Source};
use crate::object::Object;
use crate::output::{ObjectWriter, Origin};
use crate::rejected::Rejected;
use crate::robot::LoggedRobot;
use motord_bus::{Content, Frame, Unsupported};
use motord_terminal::InputFile;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

/// Limit on a line of the input, bytes. A frame has at most a few hundred; the rest of a longer
/// line is skipped.
const LINE_BYTES_MAX: usize = 4096;
/// Limit on the skipped part of a line, bytes.
const SKIPPED_BYTES_MAX: u64 = 64 << 20;

/// Whose frames are decoded.
pub(super) enum Frames {
    /// Frames of the motors of a configuration.
    OfRobot(LoggedRobot),
    /// Frames of one protocol and direction.
    Alike(Box<Codec>),
}

/// Decodes inputs, and prints the objects.
pub(super) struct Decoder<'a> {
    pub(super) frames: Frames,
    /// The interface of logs that name none.
    pub(super) interface: Option<&'a str>,
    pub(super) report: &'a mut ObjectWriter,
}

impl Decoder<'_> {
    /// Decodes an argument: `-`, a frame, a line of a log, or the name of a file.
    ///
    /// # Errors
    ///
    /// The input or the output failed.
    pub(super) fn argument(&mut self, argument: &str) -> io::Result<()> {
        if argument == "-" {
            return self.lines(None, BufReader::new(io::stdin()));
        }
        let decoded = self.line(argument, &mut Log::default());
        match decoded {
            Err((_, Rejected::LogLine(_) | Rejected::Hex { .. })) if Path::new(argument).exists() => {
                let named = |error: io::Error| io::Error::new(error.kind(), format!("{argument}: {error}"));
                let file = InputFile::open(Path::new(argument)).map_err(|error| named(error.into()))?;
                self.lines(Some(argument), BufReader::new(file.into_file())).map_err(named)
            }
            decoded => self.print(None, None, decoded),
        }
    }

    /// Prints the object of every line that is not blank; each immediately if no further line has
    /// arrived.
    fn lines(&mut self, file: Option<&str>, mut input: BufReader<impl Read>) -> io::Result<()> {
        let (mut line, mut log, mut number) = (Vec::new(), Log::default(), 0);
        while read_line(&mut input, &mut line)? {
            number += 1;
            let text = String::from_utf8_lossy(&line);
            if !text.trim().is_empty() {
                let decoded = self.line(&text, &mut log);
                self.print(file, Some(number), decoded)?;
            }
            if !input.buffer().contains(&b'\n') {
                self.report.flush()?;
            }
        }
        Ok(())
    }

    /// Decodes a line. `None` for a line of a log without a frame.
    fn line(&mut self, line: &str, log: &mut Log) -> Decoded {
        let invalid = match log.parse(line) {
            Ok(None) => return Ok(None),
            Ok(Some(entry)) => return self.entry(&entry).map(Some),
            Err(invalid) => invalid,
        };
        let decoded = match &self.frames {
            Frames::Alike(codec) if !log.has_header() => {
                hex::bytes_of_frame(line.trim()).and_then(|bytes| codec.decode(&bytes))
            }
            _ => Err(invalid.into()),
        };
        decoded.map(Some).map_err(|rejected| (Origin::default(), rejected))
    }

    fn entry(&mut self, entry: &Entry<'_>) -> Result<Object, (Origin, Rejected)> {
        let &Entry { at, source, content } = entry;
        let name = match (source, self.interface, &self.frames) {
            (Source::Interface(name), ..) | (_, Some(name), _) => Some(name),
            (Source::Channel(channel), None, Frames::OfRobot(robot)) => robot.interface(channel),
            (_, None, Frames::Alike(_)) => None,
        };
        let name = name.map(str::to_owned);
        // A double holds microseconds since 1970 exactly, nanoseconds not.
        let origin = Origin { time: at.map(|at| at.as_micros() as f64 / 1e6), interface: name };
        let interface = origin.interface.as_deref();
        let decoded = readable(content).and_then(|frame| match (&mut self.frames, interface, source) {
            (Frames::Alike(codec), ..) => codec.decode(frame.payload()),
            (Frames::OfRobot(robot), Some(interface), _) => robot.decode(interface, &frame),
            (Frames::OfRobot(_), None, Source::Channel(channel)) => Err(Rejected::Channel { channel }),
            (Frames::OfRobot(_), None, Source::Interface(_)) => Err(Rejected::Unsupported),
        });
        match decoded {
            Ok(mut object) => {
                origin.members().for_each(|(key, value)| object.insert(key, value));
                Ok(object)
            }
            Err(rejected) => Err((origin, rejected)),
        }
    }

    fn print(&mut self, file: Option<&str>, line: Option<u64>, decoded: Decoded) -> io::Result<()> {
        match decoded {
            Ok(None) => Ok(()),
            Ok(Some(object)) => self.report.object(object),
            Err((origin, rejected)) => self.report.reject(&rejected, file, line, &origin),
        }
    }
}

/// An object, or no frame, or a rejected one with its place.
type Decoded = Result<Option<Object>, (Origin, Rejected)>;

/// Returns a frame that a motor can send or read.
fn readable(content: Content) -> Result<Frame, Rejected> {
    match content {
        Content::Frame(frame) if frame.id().is_extended() => Err(Rejected::Extended { id: frame.id() }),
        Content::Frame(frame) if !frame.is_classic() => Err(Rejected::Fd { id: frame.id() }),
        Content::Frame(frame) => Ok(frame),
        Content::Error(report) => Err(Rejected::of_report(&report)),
        Content::Unsupported(Unsupported::Remote) => Err(Rejected::Remote),
        Content::Unsupported(_) | Content::Refused(_) => Err(Rejected::Unsupported),
    }
}

/// Replaces `line` by the next line, of which it keeps [`LINE_BYTES_MAX`] bytes. Returns `false` at
/// the end of the input. A line of more than [`SKIPPED_BYTES_MAX`] bytes is an error: it may have
/// no end.
fn read_line(input: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<bool> {
    line.clear();
    let (mut is_begun, mut skipped) = (false, 0);
    loop {
        let arrived = input.fill_buf()?;
        if arrived.is_empty() {
            return Ok(is_begun);
        }
        is_begun = true;
        let end = arrived.iter().position(|byte| *byte == b'\n');
        let (part, used) = end.map_or((arrived, arrived.len()), |end| (&arrived[..end], end + 1));
        let kept = part.len().min(LINE_BYTES_MAX - line.len());
        line.extend_from_slice(&part[..kept]);
        skipped += (part.len() - kept) as u64;
        input.consume(used);
        if skipped > SKIPPED_BYTES_MAX {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "a line has no end: this is no text"));
        }
        if end.is_some() {
            return Ok(true);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endless_line_is_cut_and_next_one_whole() {
        let long = vec![b'A'; 10 * LINE_BYTES_MAX];
        let text = [b"01\n\n", &long[..], b"\n02"].concat();
        let mut input = BufReader::with_capacity(1000, &text[..]);
        let (mut line, mut lengths) = (Vec::new(), Vec::new());
        while read_line(&mut input, &mut line).is_ok_and(|is_line| is_line) {
            lengths.push(line.len());
        }
        assert_eq!(lengths, [2, 0, LINE_BYTES_MAX, 2]);
        assert_eq!(line, b"", "the end of the input");
        let mut endless = BufReader::new(io::repeat(0));
        assert!(read_line(&mut endless, &mut line).is_err());
        assert!(line.len() <= LINE_BYTES_MAX);
    }
}
