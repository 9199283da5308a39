//! A recording on the disk.

use crate::failure::RecorderFailure;
use motord_client::{CycleRecord, RobotDescription};
use motord_mcap::Reader;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// A file that is being read.
pub struct Recording {
    path: PathBuf,
    reader: Reader<BufReader<File>>,
}

impl Recording {
    /// Opens the file at `path`.
    ///
    /// # Errors
    ///
    /// When it cannot be opened, or is no recording.
    pub fn open(path: &Path) -> Result<Self, RecorderFailure> {
        let file =
            File::open(path).map_err(|error| RecorderFailure::Unreadable { path: path.to_owned(), error })?;
        let reader = Reader::new(BufReader::new(file))
            .map_err(|error| RecorderFailure::Malformed { path: path.to_owned(), error })?;
        Ok(Self { path: path.to_owned(), reader })
    }

    /// The file.
    #[must_use]
    pub fn name(&self) -> String {
        self.path.display().to_string()
    }

    /// The robot.
    #[must_use]
    pub fn robot(&self) -> &RobotDescription {
        self.reader.robot()
    }

    /// The next cycle; `None` at the end of the file, or where it is damaged.
    pub fn next_cycle(&mut self) -> Option<&CycleRecord> {
        self.reader.next_cycle()
    }

    /// Why the file ended before its end; `None` when it did not, or was not read to its end yet.
    #[must_use]
    pub fn damage(&self) -> Option<&str> {
        self.reader.damage()
    }
}
