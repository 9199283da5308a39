//! Faults for simulated motors and buses: tests of a controller without a robot.

use crate::{Client, Error};
use motord_ports::Instance;
use motord_ports::injection::{self, InjectionError};
use std::io;

/// The reason why no fault was injected into a simulated motor or bus.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FaultError {
    /// The instance has a real bus.
    #[error(
        "instance {instance:?} does not support faults: one of its buses is real; try config/quadruped-simulated.toml"
    )]
    NotSimulated {
        /// The instance.
        instance: String,
    },
    /// The line is invalid, or the target does not support the fault.
    #[error("{0}")]
    Refused(String),
    /// No daemon can be reached.
    #[error(transparent)]
    Daemon(#[from] Error),
    /// The daemon did not answer: the states show whether the fault is active.
    #[error("motord did not answer: {0}")]
    NoAnswer(io::Error),
}

/// Injects the fault in `line` into a motor or bus of `instance`: `fl-knee off`, `fl-knee fault
/// over-voltage`, `front-left bus-off`, `fl-knee ok`. `motorctl sim --help` lists them. Blocks
/// until the daemon has executed it, about a cycle.
///
/// # Errors
/// [`FaultError::NotSimulated`] if one bus of the instance is real: a program cannot inject faults
/// into its motors.
pub fn inject_fault(instance: &str, line: &str) -> Result<(), FaultError> {
    let found = Instance::find(instance).map_err(Error::of_instance)?;
    injection::inject(&found, line).or_else(|error| match error {
        InjectionError::NotSimulated => {
            // Distinguishes a missing daemon from an instance with real buses.
            Client::connect(instance)?;
            Err(FaultError::NotSimulated { instance: instance.to_owned() })
        }
        InjectionError::Refused(reason) => Err(FaultError::Refused(reason)),
        InjectionError::System(error) if error.kind() == io::ErrorKind::PermissionDenied => {
            Err(Error::Permission { path: found.runtime().to_owned() }.into())
        }
        InjectionError::System(error) => Err(FaultError::NoAnswer(error)),
    })
}
