//! The errors of the command, and their exit statuses.

use crate::robot::RobotError;
use motord_protocol::ScaleError;
use motord_terminal::exit_status;
use std::io;

/// Why the command did not do all it was asked to.
#[derive(Debug, thiserror::Error)]
pub enum FrameFailure {
    /// Some frames were refused. The output holds the reason of each.
    #[error("{refused} of {total} inputs were rejected")]
    Rejected {
        /// How many.
        refused: usize,
        /// Of how many.
        total: usize,
    },
    /// The torque constant or the gear ratio is no positive number.
    #[error(transparent)]
    Scale(#[from] ScaleError),
    /// The configuration cannot be used.
    #[error(transparent)]
    Robot(#[from] RobotError),
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
            Self::Robot(_) => exit_status::CONFIG,
            Self::Io(_) => exit_status::IO,
        }
    }
}
