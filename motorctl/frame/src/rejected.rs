//! The reason why a frame was rejected.

use motord_bus::FrameId;
use motord_bus::candump::InvalidLine;
use motord_bus::serial::framing::FrameError;
use motord_protocol::{DecodeError, ScaleError};

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
    #[error("unsupported frame: expected a data frame with an 11-bit id and at most 8 bytes")]
    Unsupported,
    #[error("unexpected id {id}: no motor on {interface} receives or sends it")]
    UnexpectedId { interface: String, id: FrameId },
}
