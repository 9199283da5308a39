//! The errors of the command.

use motord_configuration::ConfigError;
use motord_protocol::ScaleError;
use motord_terminal::exit_status;
use std::io;

/// The error of the command.
#[derive(Debug, thiserror::Error)]
pub enum FrameFailure {
    /// Some inputs were rejected. The output has the reason of each.
    #[error("{refused} of {total} inputs were rejected")]
    Rejected {
        /// The number of rejected inputs.
        refused: usize,
        /// The number of inputs.
        total: usize,
    },
    /// The torque constant or the gear ratio is not a positive number.
    #[error(transparent)]
    Scale(#[from] ScaleError),
    /// The configuration has mistakes.
    #[error(transparent)]
    Configuration(#[from] ConfigError),
    /// Standard input or output failed.
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl FrameFailure {
    /// Returns the exit status.
    #[must_use]
    pub fn status(&self) -> u8 {
        match self {
            Self::Rejected { .. } => exit_status::DATA,
            Self::Scale(_) => exit_status::USAGE,
            Self::Configuration(_) => exit_status::CONFIG,
            Self::Io(_) => exit_status::IO,
        }
    }
}
