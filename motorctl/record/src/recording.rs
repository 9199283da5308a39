//! A recording on the disk.

use crate::failure::RecorderFailure;
use motord_client::{CycleRecord, RobotDescription};
use motord_mcap::Reader;
use motord_terminal::{FileError, InputFile};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// An open file.
pub struct Recording {
    path: PathBuf,
    reader: Reader<BufReader<File>>,
}

impl Recording {
    /// Opens the file at `path`.
    ///
    /// # Errors
    ///
    /// The file cannot be opened, or is no recording.
    pub fn open(path: &Path) -> Result<Self, RecorderFailure> {
        let file = InputFile::open(path).map_err(FileError::unreadable(path))?;
        let reader = Reader::new(BufReader::new(file.into_file()))
            .map_err(|error| RecorderFailure::Malformed { path: path.to_owned(), error })?;
        Ok(Self { path: path.to_owned(), reader })
    }

    /// Returns the path of the file.
    #[must_use]
    pub fn name(&self) -> String {
        self.path.display().to_string()
    }

    /// Returns the robot.
    #[must_use]
    pub fn robot(&self) -> &RobotDescription {
        self.reader.robot()
    }

    /// Returns the next cycle; `None` at the end of the file, or where it is damaged.
    pub fn next_cycle(&mut self) -> Option<&CycleRecord> {
        self.reader.next_cycle()
    }

    /// Returns the reason why the file ended early. `None` for a complete file, or before its end
    /// was read.
    #[must_use]
    pub fn damage(&self) -> Option<&str> {
        self.reader.damage()
    }
}
