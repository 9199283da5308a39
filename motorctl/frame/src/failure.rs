//! The errors of the command, and their exit statuses.

use crate::robot::RobotError;
use motord_protocol::ScaleError;
use std::io;

/// Why the command did not do all it was asked to.
#[derive(Debug, thiserror::Error)]
pub enum FrameFailure {
    /// Some frames were refused. The output holds the reason of each.
    #[error("{refused} of {total} inputs were rejected")]
    Refused {
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
    /// The exit status, of sysexits(3).
    #[must_use]
    pub fn status(&self) -> u8 {
        match self {
            Self::Refused { .. } => 65,
            Self::Scale(_) => 64,
            Self::Robot(_) => 78,
            Self::Io(_) => 74,
        }
    }
}
