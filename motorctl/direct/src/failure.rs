//! The error of a command on the bus.

use motord_bus::transport::{Cause, OpenError};
use motord_bus::{LockError, serial, socketcan};
use motord_configuration::ConfigError;
use motord_protocol::commissioning::Error;
use motord_terminal::exit_status;
use std::io;
use std::path::PathBuf;

/// The error of a command on the bus.
#[derive(Debug, thiserror::Error)]
pub enum DirectFailure {
    /// The command line is wrong. Nothing was sent.
    #[error("{0}")]
    Usage(String),
    /// The command needs consent, and there is no terminal. Nothing was sent.
    #[error("{warning}\nmotorctl: not done: repeat the command with --yes or at a terminal")]
    Unconfirmed {
        /// The effect of the command.
        warning: String,
    },
    /// The operator did not consent. Nothing was done.
    #[error("not done")]
    Declined,
    /// The bus cannot be used, or a daemon or another tool uses it.
    #[error(transparent)]
    Bus(#[from] OpenError),
    /// The configuration has mistakes.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// No motor answers.
    #[error(
        "no motor answers as id {id} on {bus}: check its power, the wiring, the termination and the bit rate; a motor with a \
         fault may answer only `motorctl fault get --protocol mit` or `--protocol gim`"
    )]
    NoMotor {
        /// The id.
        id: u8,
        /// The bus.
        bus: String,
    },
    /// No IMU sends samples on a serial port.
    #[error(
        "no IMU on {ports} serial ports: check its power and wiring, that its output is switched on, and that no other program uses the port"
    )]
    NoImu {
        /// Number of the ports.
        ports: usize,
    },
    /// An IMU was not set as asked.
    #[error("{address}: {reason}")]
    Imu {
        /// Its port, or its interface and node.
        address: String,
        /// Why, and what to do.
        reason: String,
    },
    /// No motor answers in a supported format, but frames in another one arrive.
    #[error("{source}; {formats}")]
    OtherFormat {
        /// The error without these frames.
        source: Box<DirectFailure>,
        /// The formats, and the next step.
        formats: String,
    },
    /// The motor does not understand this command, or would misunderstand it.
    #[error("motor {id}: {reason}")]
    Unfit {
        /// The motor.
        id: u8,
        /// The reason and a remedy.
        reason: String,
    },
    /// A bus does not have exactly one new motor and one missing one.
    #[error("{0}")]
    NotReplaced(String),
    /// A transaction failed.
    #[error(transparent)]
    Motor(#[from] Error),
    /// A configuration was written partly.
    #[error("{reason}; the journal {} records each write", .journal.display())]
    Apply {
        /// Why.
        reason: String,
        /// The journal.
        journal: PathBuf,
    },
    /// The configurations differ.
    #[error("{count} {} differ", if *count == 1 { "item" } else { "items" })]
    Differs {
        /// Their number.
        count: usize,
    },
    /// Standard output cannot be written.
    #[error("cannot write the output: {0}")]
    Output(#[from] io::Error),
    /// A file cannot be read or written.
    #[error("{}: {source}", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// A file has mistakes.
    #[error("{}: {reason}", .path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
}

impl DirectFailure {
    /// Returns the exit status.
    pub fn status(&self) -> u8 {
        match self {
            Self::Usage(_) | Self::Unconfirmed { .. } => exit_status::USAGE,
            Self::Bus(error) => match error.cause() {
                Cause::Forbidden => exit_status::PERMISSION,
                Cause::Locked | Cause::Busy => exit_status::BUSY,
                Cause::Absent | Cause::Other => exit_status::UNAVAILABLE,
            },
            Self::NoMotor { .. }
            | Self::NoImu { .. }
            | Self::Motor(Error::Silent { .. } | Error::Unconfirmed { .. } | Error::Bus(_)) => {
                exit_status::UNAVAILABLE
            }
            Self::OtherFormat { source, .. } => source.status(),
            Self::Motor(Error::InUse { .. } | Error::Reports { .. }) => exit_status::BUSY,
            Self::Config(_) => exit_status::CONFIG,
            Self::File { .. } | Self::Output(_) => exit_status::IO,
            Self::Malformed { .. } => exit_status::DATA,
            Self::Motor(Error::Interrupted) => exit_status::INTERRUPTED,
            Self::Declined
            | Self::Imu { .. }
            | Self::Unfit { .. }
            | Self::NotReplaced(_)
            | Self::Motor(_)
            | Self::Apply { .. }
            | Self::Differs { .. } => 1,
        }
    }
}

impl From<LockError> for DirectFailure {
    fn from(error: LockError) -> Self {
        Self::Bus(error.into())
    }
}

impl From<serial::OpenError> for DirectFailure {
    fn from(error: serial::OpenError) -> Self {
        Self::Bus(error.into())
    }
}

impl From<socketcan::OpenError> for DirectFailure {
    fn from(error: socketcan::OpenError) -> Self {
        Self::Bus(error.into())
    }
}
