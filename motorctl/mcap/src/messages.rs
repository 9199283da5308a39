//! Reads the messages of an MCAP file, which may be damaged, or made to exhaust the computer.

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::HashMap;
use std::io::{ErrorKind, Read};

/// Limit on the bytes of a record, and on those of a chunk, compressed or not. Messages of motord
/// have a kilobyte, the description of the robot some more, chunks a megabyte.
const RECORD_BYTES_MAX: usize = 16 << 20;
/// Largest size of the records as a multiple of the bytes of the file. A recording of a robot at
/// rest has 8 times its size.
const EXPANSION_MAX: u64 = 256;
/// Bytes of records that a file of any size may have.
const RECORDS_BYTES_MIN: u64 = 2 * RECORD_BYTES_MAX as u64;
/// Bytes of a record besides its content: its kind and its length.
const HEAD_BYTES: u64 = 9;
/// Limit on the bytes of a topic. Those of motord have a name of the configuration.
const TOPIC_BYTES_MAX: usize = 1024;

/// The reason why a file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file is no MCAP file, or is damaged at its beginning.
    #[error("it is no readable MCAP file: {0}")]
    Mcap(#[from] McapError),
    /// The file is an MCAP file of another program.
    #[error("it does not begin with the description of a robot: `motorctl record` has not written it")]
    NoRobot,
    /// The file would take too much memory or time.
    #[error(
        "it is damaged, or made to exhaust the computer: its records have another size than a recording's"
    )]
    Excessive,
}

/// The messages of a file, in their order. Memory is bounded by the topics of the file and by
/// [`RECORD_BYTES_MAX`], time by [`EXPANSION_MAX`].
pub(crate) struct Messages<R> {
    source: R,
    reader: LinearReader,
    topics: HashMap<u16, String>,
    /// Bytes of the file, and of the records in it.
    read: u64,
    expanded: u64,
    data: Vec<u8>,
}

impl<R: Read> Messages<R> {
    pub(crate) fn new(source: R) -> Self {
        let options = LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(RECORD_BYTES_MAX);
        let reader = LinearReader::new_with_options(options);
        Self { source, reader, topics: HashMap::new(), read: 0, expanded: 0, data: Vec::new() }
    }

    /// Returns topic and content of the next message; `None` at the end of the file.
    ///
    /// # Errors
    /// The file is damaged, or excessive. Later calls have no meaning.
    pub(crate) fn next(&mut self) -> Result<Option<(&str, &[u8])>, ReadError> {
        let Some(channel) = self.advance()? else { return Ok(None) };
        let topic = self.topics.get(&channel).ok_or(McapError::UnknownChannel(0, channel))?;
        Ok(Some((topic, &self.data)))
    }

    /// Stores the content of the next message. Returns its channel.
    fn advance(&mut self) -> Result<Option<u16>, ReadError> {
        while let Some(event) = self.reader.next_event() {
            let (opcode, data) = match event? {
                LinearReadEvent::Record { opcode, data } => (opcode, data),
                LinearReadEvent::ReadRequest(count) => {
                    self.fill(count)?;
                    continue;
                }
            };
            self.expanded += HEAD_BYTES + data.len() as u64;
            if opcode == 0 || self.expanded > RECORDS_BYTES_MIN + EXPANSION_MAX * self.read {
                return Err(ReadError::Excessive);
            }
            match opcode {
                op::DATA_END => return Ok(None),
                op::CHANNEL | op::MESSAGE => {}
                _ => continue,
            }
            match mcap::parse_record(opcode, data)? {
                Record::Channel(channel) if channel.topic.len() <= TOPIC_BYTES_MAX => {
                    self.topics.insert(channel.id, channel.topic);
                }
                Record::Message { header, data } => {
                    self.data.clear();
                    self.data.extend_from_slice(&data);
                    return Ok(Some(header.channel_id));
                }
                _ => {}
            }
        }
        Ok(None)
    }

    /// Reads up to `count` bytes of the file.
    fn fill(&mut self, count: usize) -> Result<(), McapError> {
        match self.source.read(self.reader.insert(count)) {
            Ok(read) => {
                self.read += read as u64;
                self.reader.notify_read(read);
                Ok(())
            }
            Err(error) if error.kind() == ErrorKind::Interrupted => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}
