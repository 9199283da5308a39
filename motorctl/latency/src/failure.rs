//! The errors of the command.

use motord_client::Error;
use motord_terminal::{FileError, exit_status};
use std::io;
use std::path::PathBuf;

/// The errors of the command.
#[derive(Debug, thiserror::Error)]
pub enum LatencyFailure {
    /// The daemon cannot be reached, or refused the request.
    #[error(transparent)]
    Client(#[from] Error),
    /// Standard output cannot be written.
    #[error("cannot write the output: {0}")]
    Output(#[from] io::Error),
    /// A file cannot be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// A file has mistakes.
    #[error("{} is not a valid {kind}: {wrong}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Its format.
        kind: &'static str,
        /// The first mistake.
        wrong: String,
    },
    /// The daemon sent a malformed histogram.
    #[error(
        "the daemon sent a malformed histogram of {0}; check that motord and motorctl have the same version"
    )]
    NotUnderstood(String),
    /// A run has no such quantity.
    #[error("{run} has no {quantity:?}; it has {known}")]
    NoQuantity {
        /// The run.
        run: String,
        /// The quantity.
        quantity: String,
        /// The known quantities.
        known: String,
    },
    /// `--hgrm` got several runs, or a percentile file.
    #[error("--hgrm takes one run, and an interval log or the daemon: a percentile file has no counts")]
    OneRun,
    /// No run has a sample.
    #[error("no run has a sample of {0} to draw")]
    Empty(String),
    /// The picture cannot be drawn.
    #[error("the picture cannot be drawn: {0}")]
    Picture(String),
}

impl LatencyFailure {
    /// Returns the exit status.
    #[must_use]
    pub fn status(&self) -> u8 {
        match self {
            // A refusal comes from a daemon that runs.
            Self::Client(Error::Refused { .. }) => 1,
            Self::Client(error) => error.exit_status(),
            Self::File(error) => error.exit_status(),
            Self::Output(_) => exit_status::IO,
            Self::Malformed { .. } | Self::Empty(_) => exit_status::DATA,
            Self::NoQuantity { .. } | Self::OneRun => exit_status::USAGE,
            Self::NotUnderstood(_) | Self::Picture(_) => exit_status::UNAVAILABLE,
        }
    }
}
