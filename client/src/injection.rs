//! Faults for simulated motors and buses: so that a controller can be tried against them without a robot.

use crate::{Client, Error};
use motord_ports::Instance;
use motord_ports::injection::{self, InjectionError};
use std::io;

/// Why no fault was injected into a simulated motor or bus.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FaultError {
    /// The instance has a real bus.
    #[error(
        "instance {instance:?} takes no faults: it has a bus that is not simulated; try config/quadruped-simulated.toml"
    )]
    NotSimulated {
        /// The instance.
        instance: String,
    },
    /// The line asks for no fault, or the target cannot have it.
    #[error("{0}")]
    Refused(String),
    /// No daemon can be reached.
    #[error(transparent)]
    Daemon(#[from] Error),
    /// The daemon did not answer: the states show whether the fault is there.
    #[error("motord did not answer: {0}")]
    NoAnswer(io::Error),
}

/// Gives a motor or bus of `instance` the fault that `line` asks for: `fl-knee off`, `fl-knee fault over-voltage`,
/// `front-left bus-off`, `fl-knee ok`. `motorctl sim --help` lists them. Blocks until the daemon has done it, about a cycle.
///
/// # Errors
/// [`FaultError::NotSimulated`] where one bus of the instance is real: its motors cannot be made to fail by a program.
pub fn inject_fault(instance: &str, line: &str) -> Result<(), FaultError> {
    let found = Instance::find(instance).map_err(Error::of_instance)?;
    injection::inject(&found, line).or_else(|error| match error {
        InjectionError::NotSimulated => {
            // Whether there is a daemon at all.
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
