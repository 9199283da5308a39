//! Why a command failed: a sentence for people and a status for scripts.

use crate::demo::DemoError;
use crate::frame::FrameFailure;
use motord_client::Error;
use std::io;

/// Exit statuses, of sysexits(3).
pub(crate) mod status {
    /// The command was called wrongly, or names a joint or group that does not exist.
    pub(crate) const USAGE: u8 = 64;
    /// Something that is needed is not there.
    pub(crate) const UNAVAILABLE: u8 = 69;
    /// The output could not be written.
    pub(crate) const IO: u8 = 74;
    /// Ended by Ctrl-C, as a shell reports it: 128 + SIGINT.
    pub(crate) const INTERRUPTED: u8 = 130;
}

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// The daemon cannot be reached, or refused.
    #[error(transparent)]
    Client(#[from] Error),
    /// Standard output cannot be written.
    #[error("cannot write the output: {0}")]
    Output(#[from] io::Error),
    /// The demo did not go well.
    #[error(transparent)]
    Demo(#[from] DemoError),
    /// Frames were refused.
    #[error(transparent)]
    Frame(#[from] FrameFailure),
    /// A joint's zero was to be moved without confirmation.
    #[error("this makes where {joint} stands now its zero, for good: repeat it with --yes to do it")]
    Unconfirmed {
        /// The joint.
        joint: String,
    },
    /// A signal ended the command.
    #[error("interrupted")]
    Interrupted,
}

impl Failure {
    /// The exit status.
    pub(crate) fn status(&self) -> u8 {
        match self {
            Self::Client(error) => client_status(error),
            Self::Output(_) => status::IO,
            Self::Demo(error) => error.status(),
            Self::Frame(failure) => failure.status(),
            Self::Unconfirmed { .. } => status::USAGE,
            Self::Interrupted => status::INTERRUPTED,
        }
    }

    /// The reader of the output has gone, as `head` does: the normal end of a pipeline, nothing to complain about.
    pub(crate) fn is_closed_pipe(&self) -> bool {
        let (Self::Output(error) | Self::Frame(FrameFailure::Io(error))) = self else { return false };
        error.kind() == io::ErrorKind::BrokenPipe
    }
}

/// The exit status for an error of the client. A refusal comes from a daemon that is there: not 69.
pub(crate) fn client_status(error: &Error) -> u8 {
    match error {
        Error::Refused { .. } => 1,
        error => error.exit_status(),
    }
}
