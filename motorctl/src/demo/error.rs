//! The errors of the demo.

use crate::demo::gait::GROUP;
use crate::demo::report::{Shortfall, failures};
use crate::exit_status;
use crate::failure::CommandFailure;
use motord_client::{Cause, Error};
use std::io;
use std::path::PathBuf;
use std::process::ExitStatus;
use std::time::Duration;

/// Longest time until the daemon has its services open.
pub(crate) const READY_MAX: Duration = Duration::from_secs(10);
/// Longest time between two messages of the controller. Finding and starting the motors takes the
/// longest.
pub(crate) const SILENCE_MAX: Duration = Duration::from_secs(20);

/// Why the demo failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DemoError {
    /// The daemon's executable is missing.
    #[error("{} is missing: build it with `cargo build --release`", .0.display())]
    NoDaemon(PathBuf),
    /// A file or process could not be used.
    #[error("cannot {doing}: {source}")]
    System {
        /// The action that failed.
        doing: &'static str,
        /// Why it failed.
        source: io::Error,
    },
    /// The daemon ended unexpectedly.
    #[error("motord ended with {status}; the end of its log:\n{log}")]
    DaemonEnded {
        /// How.
        status: ExitStatus,
        /// The end of its log.
        log: String,
    },
    /// The daemon runs, but offers no services.
    #[error("motord was not ready after {} s; the end of its log:\n{log}", READY_MAX.as_secs())]
    NotReady {
        /// The end of its log.
        log: String,
    },
    /// The daemon failed while it was stopped.
    #[error("motord ended with {status} when it was stopped; the end of its log:\n{log}")]
    DaemonStop {
        /// How.
        status: ExitStatus,
        /// The end of its log.
        log: String,
    },
    /// The daemon stopped the group in mid-trot.
    #[error("the group {GROUP} was stopped: {}", .0.map_or("no cause is latched", Cause::sentence))]
    Stopped(Option<Cause>),
    /// Motors were not found, started or stopped in time.
    #[error("the group {GROUP} was not {change} within {seconds} s")]
    Slow {
        /// The state that it did not reach.
        change: &'static str,
        /// The time it had, s.
        seconds: f64,
    },
    /// The controller failed.
    #[error("the controller ended with {status}; the end of its log:\n{log}")]
    Controller {
        /// How.
        status: ExitStatus,
        /// The end of its log.
        log: String,
    },
    /// The controller sends no messages.
    #[error("the controller sent no message for {} s", SILENCE_MAX.as_secs())]
    ControllerSilent,
    /// The daemon cannot be reached.
    #[error(transparent)]
    Client(#[from] Error),
    /// The run ended beyond a limit.
    #[error("{}", failures(.overload.as_deref(), .shortfalls).join("; "))]
    Shortfalls {
        /// An overload of the computer, which is reported first.
        overload: Option<String>,
        /// The limits.
        shortfalls: Vec<Shortfall>,
    },
    /// The demo failed with this exit status. Standard output has the reason.
    #[error("the demo failed")]
    Printed(u8),
    /// A signal ended the demo, for example by Ctrl-C.
    #[error("interrupted; the daemon and its controller are stopped")]
    Interrupted,
}

impl CommandFailure for DemoError {
    fn status(&self) -> u8 {
        match self {
            Self::NoDaemon(_) => exit_status::UNAVAILABLE,
            Self::Interrupted => exit_status::INTERRUPTED,
            Self::Printed(status) => *status,
            Self::Client(error) => exit_status::of_client(error),
            _ => 1,
        }
    }

    fn is_printed(&self) -> bool {
        matches!(self, Self::Printed(_))
    }
}

impl DemoError {
    /// Returns a function that names the failed action of an `io::Error`.
    pub(crate) fn system(doing: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::System { doing, source }
    }
}
