//! Why the daemon does not run, or why it ended by itself.

use crate::buses::other_senders::OtherSender;
use crate::buses::{BusError, PlantedError};
use motord_configuration::ConfigError;
use motord_ports::instance::InstanceError;
use motord_ports::service::ServiceError;
use motord_realtime::descriptors::TooFewDescriptors;
use motord_terminal::exit_status;
use std::io;
use std::path::PathBuf;

/// Why the daemon does not run.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The configuration is refused.
    #[error("{0}")]
    Config(#[from] ConfigError),
    /// The lock file is no lock file.
    #[error("{0}")]
    Lock(#[from] motord_configuration::lock::LockError),
    /// The instance's directory cannot be used, or another daemon holds it.
    #[error("{0}")]
    Instance(#[from] InstanceError),
    /// A bus cannot be opened.
    #[error("{0}")]
    Bus(#[from] BusError),
    /// Another sender commands the motors.
    #[error("{0}")]
    OtherSender(#[from] OtherSender),
    /// The robot has no twin, or the plant does not take it.
    #[error("{0}")]
    Plant(#[from] PlantedError),
    /// The plant ended while the daemon ran.
    #[error("{0}")]
    PlantEnded(String),
    /// Clients cannot be served.
    #[error("{0}")]
    Service(#[from] ServiceError),
    /// `require-realtime` is set, and the machine refuses.
    #[error("require-realtime is set, but there is no {what} ({errno}): {remedy}")]
    Realtime {
        /// The real-time setting that was refused.
        what: &'static str,
        /// Why.
        errno: nix::errno::Errno,
        /// An instruction for the operator.
        remedy: std::borrow::Cow<'static, str>,
    },
    /// Clients could not be served.
    #[error("{0}")]
    Descriptors(#[from] TooFewDescriptors),
    /// A thread could not be started, or signals not be waited for.
    #[error("the system refused a thread or a signal: {0}")]
    System(#[from] io::Error),
    /// A thread ended that should not.
    #[error("the {0} thread ended unexpectedly: this is a bug, the motors were commanded to stop")]
    Thread(&'static str),
    /// Another process removed a file by which clients find the daemon.
    #[error(
        "{} was removed or replaced, and no new client could reach this daemon: the motors were commanded to stop",
        .0.display()
    )]
    DirectoryLost(PathBuf),
    /// These motors did not answer their stops, and may hold their last command.
    #[error("these motors did not answer the stop command: {}; cut their power before a person approaches", .0.join(", "))]
    Unstopped(Vec<String>),
}

impl RunError {
    /// The exit status, by `sysexits.h`.
    #[must_use]
    pub fn exit_status(&self) -> u8 {
        match self {
            Self::Config(_) | Self::Lock(_) | Self::Realtime { .. } | Self::Plant(PlantedError::Twin(_)) => {
                exit_status::CONFIG
            }
            Self::Instance(error) if error.is_a_setting() => exit_status::CONFIG,
            Self::OtherSender(_) | Self::Instance(InstanceError::AlreadyRunning { .. }) => exit_status::BUSY,
            Self::Bus(error) if error.is_locked() => exit_status::BUSY,
            Self::Instance(_) => exit_status::PERMISSION,
            Self::Bus(_)
            | Self::Plant(_)
            | Self::PlantEnded(_)
            | Self::Service(_)
            | Self::DirectoryLost(_)
            | Self::Unstopped(_) => exit_status::UNAVAILABLE,
            Self::Descriptors(_) | Self::System(_) => exit_status::OS,
            Self::Thread(_) => exit_status::SOFTWARE,
        }
    }
}
