//! The error of a command: a sentence for operators and an exit status for scripts.

use crate::confirmation;
use crate::exit_status;
use motord_client::{Error, FaultError};
use motord_direct::DirectFailure;
use motord_doctor::DoctorFailure;
use motord_frame::FrameFailure;
use motord_latency::LatencyFailure;
use motord_record::RecorderFailure;
use std::io;

/// An error of one command, which only its module knows.
pub(crate) trait CommandFailure: std::error::Error {
    /// Returns the exit status.
    fn status(&self) -> u8;

    /// Returns true when standard output has the reason.
    fn is_printed(&self) -> bool {
        false
    }
}

/// The error of a command.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// The daemon cannot be reached, or refused the request.
    #[error(transparent)]
    Client(#[from] Error),
    /// A group is not reset, because its motors are not stopped.
    #[error("{0} While motord damps them, `--wait` waits for the end.")]
    NotStoppedYet(Error),
    /// An emergency stop was not confirmed.
    #[error("EMERGENCY STOP NOT CONFIRMED: cut the power\nmotorctl: {0}")]
    NotStopped(Error),
    /// `estop --all` found no daemon. The text names processes of other users, if there are any.
    #[error("EMERGENCY STOP NOT CONFIRMED: cut the power\nmotorctl: no motord runs on this computer{}", also(.0))]
    NothingToStop(String),
    /// `estop --all` stopped only some daemons.
    #[error("EMERGENCY STOP NOT CONFIRMED: cut the power\nmotorctl: {}", .0.join("\nmotorctl: "))]
    NotAllStopped(Vec<String>),
    /// An emergency stop was confirmed, but these motors do not answer.
    #[error("the stop is confirmed, {}", confirmation::motors_silent(.0))]
    MotorsSilent(String),
    /// Standard output cannot be written.
    #[error("cannot write the output: {0}")]
    Output(#[from] io::Error),
    /// One command failed in a way of its own.
    #[error("{0}")]
    Command(Box<dyn CommandFailure>),
    /// The computer is not fit for a real-time cycle, or the checks failed.
    #[error(transparent)]
    Doctor(#[from] DoctorFailure),
    /// Frames were rejected.
    #[error(transparent)]
    Frame(#[from] FrameFailure),
    /// Latencies cannot be requested, read or written.
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
    /// There is no page of this name.
    #[error("there is no page {name}: {}`motorctl explain` lists all names", did_you_mean(.near))]
    NoPage {
        /// The name.
        name: String,
        /// Names that are similar to it.
        near: Vec<&'static str>,
    },
    /// The mount of an IMU cannot be measured now.
    #[error("the mount of {imu} is not measured: {reason}")]
    Level {
        /// The IMU.
        imu: String,
        /// Why, and what to do.
        reason: String,
    },
    /// `status --check` found troubles. They were printed.
    #[error("the robot has troubles")]
    Troubled,
    /// A signal ended the command.
    #[error("interrupted")]
    Interrupted,
}

impl<F: CommandFailure + 'static> From<F> for Failure {
    fn from(failure: F) -> Self {
        Self::Command(Box::new(failure))
    }
}

impl Failure {
    /// Returns the exit status.
    pub(crate) fn status(&self) -> u8 {
        match self {
            Self::Client(error) | Self::NotStoppedYet(error) => exit_status::of_client(error),
            Self::NotStopped(error) => exit_status::of_stop(error),
            Self::NothingToStop(_) => exit_status::UNAVAILABLE,
            Self::NotAllStopped(_) => exit_status::NOT_STOPPED,
            Self::MotorsSilent(_) => exit_status::MOTORS_SILENT,
            Self::Output(_) => exit_status::IO,
            Self::Command(failure) => failure.status(),
            Self::Doctor(failure) => failure.status(),
            Self::Frame(failure) => failure.status(),
            Self::Latency(failure) => failure.status(),
            Self::Recorder(failure) => failure.status(),
            Self::Direct(failure) => failure.status(),
            Self::Sim(FaultError::Daemon(error)) => exit_status::of_client(error),
            Self::Sim(FaultError::Refused(_)) => exit_status::USAGE,
            Self::Sim(_) => exit_status::UNAVAILABLE,
            Self::NoTerminal | Self::NoPage { .. } => exit_status::USAGE,
            Self::Troubled | Self::Level { .. } => 1,
            Self::Interrupted => exit_status::INTERRUPTED,
        }
    }

    /// Returns true when no message is needed: the reason is on standard output, or a signal ended
    /// the command.
    pub(crate) fn is_printed(&self) -> bool {
        match self {
            Self::Command(failure) => failure.is_printed(),
            Self::Interrupted
            | Self::Troubled
            | Self::Doctor(DoctorFailure::Unfit | DoctorFailure::Interrupted) => true,
            _ => false,
        }
    }

    /// Returns true when no daemon of this name runs. Others may run.
    pub(crate) fn is_not_running(&self) -> bool {
        matches!(
            self,
            Self::Client(Error::NotRunning { .. })
                | Self::NotStopped(Error::NotRunning { .. })
                | Self::Latency(LatencyFailure::Client(Error::NotRunning { .. }))
                | Self::Recorder(RecorderFailure::Client(Error::NotRunning { .. }))
        )
    }

    /// Returns true when the reader of the output closed it, as `head` does: no error.
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

/// Returns a text that is not empty, on a line of its own.
fn also(text: &str) -> String {
    if text.is_empty() { String::new() } else { format!("\nmotorctl: {text}") }
}

/// `did you mean `motor-lost` or `motor-fault`? `; empty without a name.
fn did_you_mean(near: &[&str]) -> String {
    let near: Vec<_> = near.iter().map(|name| format!("`{name}`")).collect();
    if near.is_empty() { String::new() } else { format!("did you mean {}? ", near.join(" or ")) }
}
