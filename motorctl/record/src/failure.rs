//! Reasons why a command fails.

use motord_client::Error;
use motord_mcap::ReadError;
use motord_terminal::{FileError, exit_status};
use std::io;
use std::path::PathBuf;

/// The reason why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum RecorderFailure {
    /// The daemon cannot be reached, or has ended. A started file is complete.
    #[error(transparent)]
    Client(#[from] Error),
    /// A file cannot be read or written. The written part of a recording can be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// Standard output cannot be written.
    #[error("cannot write the output: {0}")]
    Output(#[from] io::Error),
    /// A file is no recording.
    #[error("{}: {error}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The error.
        error: ReadError,
    },
    /// The robot of a recording has no such joint or IMU.
    #[error("there is no joint or IMU {name:?}; the recording has {known}")]
    NoSubject {
        /// The name.
        name: String,
        /// The joints and IMUs of the recording.
        known: String,
    },
    /// The recording contains nothing to draw.
    #[error(
        "there is nothing to draw: no cycle of the recording has a value of these joints and IMUs in this time"
    )]
    Empty,
    /// The picture cannot be drawn.
    #[error("the picture cannot be drawn: {0}")]
    Picture(String),
}

impl RecorderFailure {
    /// Returns the exit status.
    #[must_use]
    pub fn status(&self) -> u8 {
        match self {
            Self::Client(error) => error.exit_status(),
            Self::File(error) => error.exit_status(),
            Self::Output(_) => exit_status::IO,
            Self::Malformed { .. } | Self::Empty => exit_status::DATA,
            Self::NoSubject { .. } => exit_status::USAGE,
            Self::Picture(_) => exit_status::UNAVAILABLE,
        }
    }
}
