//! The errors of `motorctl identify`.

use crate::failure::CommandFailure;
use motord_identify::PlanError;
use std::io;
use std::path::PathBuf;

/// Why nothing was identified.
#[derive(Debug, thiserror::Error)]
pub(crate) enum IdentifyFailure {
    /// The motor has no stiffness.
    #[error(
        "{0} has the native protocol, which has no stiffness and damping: set its motor to MIT (`motorctl set-protocol`), or measure \
         it on a bench"
    )]
    Native(String),
    /// The joint has not reported a position.
    #[error("{0} does not answer: `motorctl status` shows its motor")]
    Silent(String),
    /// The joint cannot be moved as asked, or its motion ended.
    #[error("{joint} is not identified: {reason}")]
    Plan {
        /// The joint.
        joint: String,
        /// The reason.
        reason: PlanError,
    },
    /// A signal ended the motion.
    #[error(
        "{0} is not identified: the motion was interrupted. Its group is stopped, after damping what moves"
    )]
    Interrupted(String),
    /// The recording does not show an inertia.
    #[error(
        "{0}: the inertia is not identifiable. Check that the joint turns freely, and try a larger --amplitude-rad, --kp or --seconds"
    )]
    Nothing(String),
    /// The joint moves in another way than the equation.
    #[error(
        "{0} is not identified: it does not move by the equation of inertia, friction and gravity. Look for play, an elastic part, a \
         loose screw or a collision"
    )]
    Misfit(String),
    /// Too much of the motion is missing.
    #[error("{joint} is not identified: {reason}")]
    Losses {
        /// The joint.
        joint: String,
        /// The loss, and what to do.
        reason: String,
    },
    /// The file of an identification without load cannot be used.
    #[error(
        "{path}: {reason}. Write it with `motorctl identify {joint} --json >{path}`, without the known load"
    )]
    Without {
        /// The file.
        path: String,
        /// The joint.
        joint: String,
        /// The reason.
        reason: String,
    },
    /// The lines cannot be written.
    #[error("{}: {source}", .path.display())]
    Output {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: io::Error,
    },
}

impl CommandFailure for IdentifyFailure {
    fn status(&self) -> u8 {
        use crate::exit_status::{DATA, INTERRUPTED, IO, USAGE};
        match self {
            Self::Native(_) | Self::Plan { reason: PlanError::Narrow { .. }, .. } => USAGE,
            Self::Silent(_)
            | Self::Plan { .. }
            | Self::Nothing(_)
            | Self::Misfit(_)
            | Self::Losses { .. } => 1,
            Self::Interrupted(_) => INTERRUPTED,
            Self::Without { .. } => DATA,
            Self::Output { .. } => IO,
        }
    }
}
