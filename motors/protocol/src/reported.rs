//! The entries of the lock file: a motor's reports about itself.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Requests by which the protocol of a motor is determined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Question {
    /// The frames of a scan.
    Both,
    /// First RobStride's question for the device, then the frames of a scan.
    PrivateFirst,
    /// Only the request for the estimates of a CANSimple driver.
    Node,
    /// Only MyActuator's question for the status.
    MotorStatus,
    /// Only an MIT stop frame. A motor in native mode refuses it, which identifies the motor.
    MitOnly,
}

/// A motor, as it reports itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct ReportedMotor {
    /// Its name in the configuration.
    pub name: String,
    /// Name of its bus.
    pub bus: String,
    /// The id at which it answered.
    pub id: u8,
    /// The id of its answers; `None` when it is not known.
    pub host_id: Option<u32>,
    /// The protocol of its answer.
    pub protocol: ReportedProtocol,
    /// Version of its firmware; only in native mode.
    pub firmware: Option<u32>,
    /// Configuration items by their names of Table 7 of the GIM document; only in native mode.
    #[serde(default)]
    pub values: BTreeMap<String, f64>,
}

/// The protocol of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReportedProtocol {
    /// MIT with answers of six bytes.
    Mit,
    /// MIT with longer answers: another vendor, or another family of drivers.
    OtherMit,
    /// The native protocol.
    Gim,
    /// RobStride's private protocol.
    #[serde(rename = "robstride")]
    RobStride,
    /// CANSimple.
    #[serde(rename = "cansimple")]
    CanSimple,
    /// MyActuator's own protocol.
    #[serde(rename = "myactuator")]
    MyActuator,
    /// A protocol that is not known.
    Unknown,
}

impl ReportedProtocol {
    /// Returns a term for a table.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Mit => "mit",
            Self::OtherMit => "mit of another vendor or driver",
            Self::Gim => "gim",
            Self::RobStride => "robstride",
            Self::CanSimple => "cansimple",
            Self::MyActuator => "myactuator",
            Self::Unknown => "unknown",
        }
    }
}
