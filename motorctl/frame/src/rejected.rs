//! The reason why a frame was rejected, and the errors of the command.

use motord_bus::candump::InvalidLine;
use motord_bus::frame::ControllerState;
use motord_bus::serial::framing::FrameError;
use motord_bus::{ErrorFrame, FrameId};
use motord_configuration::ConfigError;
use motord_protocol::imu::SampleError;
use motord_protocol::{DecodeError, ScaleError};
use motord_terminal::exit_status;
use std::io;

/// The reason why a frame was rejected.
#[derive(Debug, thiserror::Error)]
pub(super) enum Rejected {
    #[error(transparent)]
    Decode(#[from] DecodeError),
    #[error(transparent)]
    Serial(#[from] FrameError),
    #[error(transparent)]
    Scale(#[from] ScaleError),
    #[error("'{received}' is not hexadecimal with two digits per byte")]
    Hex { received: String },
    #[error("not a JSON object: {0}")]
    Json(serde_json::Error),
    #[error("not a JSON object: {received}")]
    NoObject { received: String },
    #[error("'{key}' occurs twice")]
    Repeated { key: String },
    #[error("kind '{received}' does not exist in this protocol and direction")]
    Kind { received: String },
    #[error("'{key}' is missing")]
    Missing { key: &'static str },
    #[error("'{key}' is {received}, expected {expected}")]
    Type { key: &'static str, expected: &'static str, received: String },
    #[error("'{key}' is {received}, expected {least} to {most}")]
    Range { key: &'static str, least: i64, most: i64, received: String },
    #[error("'{raw}' is {code}, but the code nearest to '{physical}' is {nearest}")]
    Disagree { raw: &'static str, code: u16, physical: &'static str, nearest: u16 },
    #[error("'{key}' is {received}, but the frame has {expected}")]
    Contradiction { key: String, received: String, expected: String },
    #[error("'{key}' is not in this frame")]
    UnknownKey { key: String },
    #[error("'{physical}' needs the torque constant and the gear ratio")]
    NoScale { physical: &'static str },
    #[error("'null_bytes' has {received} bytes, expected {least} to {most}")]
    NullBytes { least: usize, most: usize, received: usize },
    #[error("the values of this command occupy bytes that must be neutral for a motor in MIT mode")]
    NotMitSafe,
    #[error(transparent)]
    LogLine(#[from] InvalidLine),
    #[error("motor {motor} has a protocol that this command does not decode")]
    Family { motor: String },
    #[error("unsupported frame: expected a data frame with an 11-bit id and at most 8 bytes")]
    Unsupported,
    #[error("remote frame: no motor sends or reads one")]
    Remote,
    #[error("frame with the 29-bit id {id}: no motor sends or reads one")]
    Extended { id: FrameId },
    #[error("CAN FD frame with the id {id}: no motor sends or reads one")]
    Fd { id: FrameId },
    #[error("bus off: the controller of the interface has left the bus")]
    BusOff,
    #[error("error frame: the controller is {state}")]
    Controller { state: &'static str },
    #[error("error frame of class {class:#x}: {names}")]
    ErrorFrame { class: u32, names: String },
    #[error("channel {channel} has no interface in the configuration: use --interface NAME")]
    Channel { channel: u32 },
    #[error("imu {imu}: {error}")]
    Imu { imu: String, error: SampleError },
    #[error("unexpected id {id}: no motor on {interface} receives or sends it")]
    UnexpectedId { interface: String, id: FrameId },
}

/// `CAN_ERR_TRX` of `linux/can/error.h`.
const TRANSCEIVER: u32 = 0x010;

/// The classes of an error frame, with words of `candump -e`.
const CLASSES: [(u32, &str); 8] = [
    (ErrorFrame::TX_TIMEOUT, "time-out of a transmission"),
    (ErrorFrame::LOST_ARBITRATION, "lost arbitration"),
    (ErrorFrame::CONTROLLER, "problem of the controller"),
    (ErrorFrame::PROTOCOL, "protocol violation"),
    (TRANSCEIVER, "problem of the transceiver"),
    (ErrorFrame::NO_ACKNOWLEDGE, "no acknowledgement"),
    (ErrorFrame::BUS_ERROR, "bus error"),
    (ErrorFrame::RESTARTED, "controller restarted"),
];

impl Rejected {
    /// Names a report of a controller.
    pub(super) fn of_report(report: &ErrorFrame) -> Self {
        let class = report.class;
        let names: Vec<_> =
            CLASSES.iter().filter(|(bit, _)| class & bit != 0).map(|(_, name)| *name).collect();
        match report.state() {
            Some(ControllerState::Off) => Self::BusOff,
            Some(ControllerState::Passive) => Self::Controller { state: "error passive" },
            Some(ControllerState::Warning) => Self::Controller { state: "at its error warning limit" },
            Some(ControllerState::Active) => Self::Controller { state: "error active again" },
            None if names.is_empty() => Self::ErrorFrame { class, names: "unknown".into() },
            None => Self::ErrorFrame { class, names: names.join(", ") },
        }
    }
}

/// The error of the command.
#[derive(Debug, thiserror::Error)]
pub enum FrameFailure {
    /// Some inputs were rejected. The output has the reason of each.
    #[error("{refused} of {total} inputs were rejected")]
    Rejected {
        /// The number of rejected inputs.
        refused: usize,
        /// The number of inputs.
        total: usize,
    },
    /// The torque constant or the gear ratio is not a positive number.
    #[error(transparent)]
    Scale(#[from] ScaleError),
    /// The configuration has mistakes.
    #[error(transparent)]
    Configuration(#[from] ConfigError),
    /// No vendor and no model has this name.
    #[error("there is no vendor and no model {0}; `motorctl models` lists them")]
    NoModel(String),
    /// Standard input or output failed.
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl FrameFailure {
    /// Returns the exit status.
    #[must_use]
    pub fn status(&self) -> u8 {
        match self {
            Self::Rejected { .. } => exit_status::DATA,
            Self::Scale(_) | Self::NoModel(_) => exit_status::USAGE,
            Self::Configuration(_) => exit_status::CONFIG,
            Self::Io(_) => exit_status::IO,
        }
    }
}
