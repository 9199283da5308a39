//! Why a command failed: a sentence for operators and a status for scripts.

use crate::demo::error::DemoError;
use crate::exit_status;
use motord_client::{Error, FaultError};
use motord_direct::DirectFailure;
use motord_doctor::DoctorFailure;
use motord_frame::FrameFailure;
use motord_latency::LatencyFailure;
use motord_record::RecorderFailure;
use std::io;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// The daemon cannot be reached, or refused.
    #[error(transparent)]
    Client(#[from] Error),
    /// Nobody confirmed an emergency stop.
    #[error("EMERGENCY STOP NOT CONFIRMED: cut the power\nmotorctl: {0}")]
    NotStopped(Error),
    /// Standard output cannot be written.
    #[error("cannot write the output: {0}")]
    Output(#[from] io::Error),
    /// The demo did not go well.
    #[error(transparent)]
    Demo(#[from] DemoError),
    /// The computer is not fit, or could not be judged.
    #[error(transparent)]
    Doctor(#[from] DoctorFailure),
    /// Frames were refused.
    #[error(transparent)]
    Frame(#[from] FrameFailure),
    /// The latencies cannot be had, read or written.
    #[error(transparent)]
    Latency(#[from] LatencyFailure),
    /// Nothing was recorded, or a recording cannot be read or drawn.
    #[error(transparent)]
    Recorder(#[from] RecorderFailure),
    /// A command on the bus failed, or was not confirmed.
    #[error(transparent)]
    Direct(#[from] DirectFailure),
    /// No fault was injected.
    #[error(transparent)]
    Sim(#[from] FaultError),
    /// The monitor was started without a terminal.
    #[error("the monitor needs a terminal: use `motorctl status`, or `motorctl watch --json` for scripts")]
    NoTerminal,
    /// The book has no such name.
    #[error("nothing is called {0}: `motorctl explain` lists all names")]
    NoPage(String),
    /// `status --check` found something, and has printed it.
    #[error("the robot is not well")]
    Troubled,
    /// A signal ended the command.
    #[error("interrupted")]
    Interrupted,
}

impl Failure {
    /// The exit status.
    pub(crate) fn status(&self) -> u8 {
        match self {
            Self::Client(error) => exit_status::of_client(error),
            Self::NotStopped(error) => exit_status::of_stop(error),
            Self::Output(_) => exit_status::IO,
            Self::Demo(error) => error.status(),
            Self::Doctor(failure) => failure.status(),
            Self::Frame(failure) => failure.status(),
            Self::Latency(failure) => failure.status(),
            Self::Recorder(failure) => failure.status(),
            Self::Direct(failure) => failure.status(),
            Self::Sim(FaultError::Daemon(error)) => exit_status::of_client(error),
            Self::Sim(FaultError::Refused(_)) => exit_status::USAGE,
            Self::Sim(_) => exit_status::UNAVAILABLE,
            Self::NoTerminal | Self::NoPage(_) => exit_status::USAGE,
            Self::Troubled => 1,
            Self::Interrupted => exit_status::INTERRUPTED,
        }
    }

    /// Nothing is left to say: standard output has the reason, or the sender of a signal knows it.
    pub(crate) fn is_printed(&self) -> bool {
        matches!(
            self,
            Self::Interrupted
                | Self::Troubled
                | Self::Demo(DemoError::Printed(_))
                | Self::Doctor(DoctorFailure::Unfit | DoctorFailure::Interrupted)
        )
    }

    /// There is no daemon of this name: others may run.
    pub(crate) fn is_not_running(&self) -> bool {
        matches!(
            self,
            Self::Client(Error::NotRunning { .. })
                | Self::NotStopped(Error::NotRunning { .. })
                | Self::Latency(LatencyFailure::Client(Error::NotRunning { .. }))
                | Self::Recorder(RecorderFailure::Client(Error::NotRunning { .. }))
        )
    }

    /// The reader of the output has gone, as `head` does: the normal end of a pipeline, nothing to complain about.
    pub(crate) fn is_closed_pipe(&self) -> bool {
        let (Self::Output(error)
        | Self::Doctor(DoctorFailure::Output(error))
        | Self::Frame(FrameFailure::Io(error))
        | Self::Latency(LatencyFailure::Output(error))
        | Self::Recorder(RecorderFailure::Output(error))
        | Self::Direct(DirectFailure::Output(error))) = self
        else {
            return false;
        };
        error.kind() == io::ErrorKind::BrokenPipe
    }
}
