//! Reads a motor's reports about itself, as far as its protocol supports them. Changes and moves
//! nothing.

use crate::commissioning::scan::{Family, Found, identify_by, identify_in_mit};
use crate::gim::commissioning::Native;
use crate::gim::{ConfigurationItem, Value};
use crate::link::Error;
use crate::link::{Link, Wire};
use crate::reported::{Question, ReportedMotor, ReportedProtocol};
use motord_bus::FrameId;

/// Returns the configuration items that determine torque and angle.
pub fn constants() -> impl Iterator<Item = &'static ConfigurationItem> {
    ConfigurationItem::CONSTANTS.into_iter().filter_map(ConfigurationItem::by_name)
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
                Family::MyActuator => ReportedProtocol::MyActuator,
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
        question => identify_by(link, id, question)?,
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
