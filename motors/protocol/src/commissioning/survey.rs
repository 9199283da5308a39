//! Reads a motor's reports about itself, as far as its protocol supports them. Changes and moves
//! nothing.

use crate::commissioning::scan::{Family, Found, identify, identify_in_mit, identify_node, identify_private};
use crate::gim::commissioning::Native;
use crate::gim::{ConfigurationItem, Value};
use crate::link::Error;
use crate::link::{Link, Wire};
use crate::reported::{ReportedMotor, ReportedProtocol};
use motord_bus::FrameId;

/// Returns the configuration items that determine torque and angle.
pub fn constants() -> impl Iterator<Item = &'static ConfigurationItem> {
    ConfigurationItem::CONSTANTS.into_iter().filter_map(ConfigurationItem::by_name)
}

/// Requests by which the protocol of a motor is determined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Question {
    /// The frames of a scan.
    Both,
    /// First RobStride's question for the device, then the frames of a scan.
    PrivateFirst,
    /// Only the request for the estimates of a CANSimple driver.
    Node,
    /// Only an MIT stop frame. A motor in native mode refuses it, which identifies the motor.
    MitOnly,
}

/// A motor's reports about itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Survey {
    /// Its protocol and ids.
    pub found: Found,
    /// Version of its firmware; only in native mode.
    pub firmware: Option<u32>,
    /// Configuration items that it reported; only in native mode.
    pub values: Vec<(&'static ConfigurationItem, Value)>,
}

impl Survey {
    /// Returns the entry of the lock file: the motor `name` on the bus `bus` of the configuration.
    #[must_use]
    pub fn reported(&self, name: &str, bus: &str) -> ReportedMotor {
        ReportedMotor {
            name: name.to_owned(),
            bus: bus.to_owned(),
            id: self.found.id,
            host_id: self.found.host_id.map(FrameId::raw),
            protocol: match self.found.family {
                Family::Native => ReportedProtocol::Gim,
                Family::Mit => ReportedProtocol::Mit,
                Family::OtherMit { .. } => ReportedProtocol::OtherMit,
                Family::RobStride { .. } => ReportedProtocol::RobStride,
                Family::CanSimple => ReportedProtocol::CanSimple,
                Family::Unknown { .. } => ReportedProtocol::Unknown,
            },
            firmware: self.firmware,
            values: self.values.iter().map(|(item, value)| (item.name.to_owned(), value.as_f64())).collect(),
        }
    }
}

/// Reads the protocol of motor `id`, and in native mode its version and `items`. `None` when no
/// motor answers. Items that the motor refuses, or does not answer, are left out.
///
/// # Errors
///
/// [`Error::Bus`]; [`Error::Protocol`] when several motors answer to the id.
pub fn survey(
    link: &mut Link,
    id: u8,
    question: Question,
    items: impl IntoIterator<Item = &'static ConfigurationItem>,
) -> Result<Option<Survey>, Error> {
    let found = match question {
        Question::MitOnly if link.wire() == Wire::Can => identify_in_mit(link, id)?,
        Question::PrivateFirst if link.wire() == Wire::Can => match identify_private(link, id)? {
            Some(found) => Some(found),
            None => identify(link, id)?,
        },
        Question::Node => identify_node(link, id)?,
        Question::MitOnly | Question::PrivateFirst | Question::Both => identify(link, id)?,
    };
    let Some(found) = found else { return Ok(None) };
    let mut survey = Survey { found, firmware: None, values: Vec::new() };
    if found.family != Family::Native {
        return Ok(Some(survey));
    }
    let mut motor = Native::new(link, id, found.host_id);
    survey.firmware = answered(motor.version())?;
    for item in items {
        let value = answered(motor.configuration(item.key()))?;
        survey.values.extend(value.map(|value| (item, value)));
    }
    Ok(Some(survey))
}

/// A motor that refuses or misses one request may answer the next.
fn answered<T>(answer: Result<T, Error>) -> Result<Option<T>, Error> {
    match answer {
        Ok(value) => Ok(Some(value)),
        Err(error @ Error::Bus(_)) => Err(error),
        Err(_) => Ok(None),
    }
}
