//! The constants behind a torque code, kept as they were given, so that an object can have them.

use crate::frame::object::Object;
use crate::frame::refused::Refused;
use motord_protocol::{ScaleError, TorqueScale};

/// The torque constant, the gear ratio and the torque scale that follows from them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scale {
    /// The rotor's torque constant, N·m/A.
    torque_constant: f64,
    /// Rotor turns per turn of the output shaft.
    gear_ratio: f64,
    pub(super) torque: TorqueScale,
}

impl Scale {
    pub(super) fn new(torque_constant: f64, gear_ratio: f64) -> Result<Self, ScaleError> {
        let torque = TorqueScale::new(torque_constant, gear_ratio)?;
        Ok(Self { torque_constant, gear_ratio, torque })
    }

    /// Puts the constants into `object`.
    pub(super) fn write(&self, object: &mut Object) {
        object.insert("torque_constant", self.torque_constant);
        object.insert("gear_ratio", self.gear_ratio);
    }

    /// The constants in `object`, if it has them.
    pub(super) fn of(object: &Object) -> Result<Option<Self>, Refused> {
        if !object.has("torque_constant") && !object.has("gear_ratio") {
            return Ok(None);
        }
        Ok(Some(Self::new(object.number("torque_constant")?, object.number("gear_ratio")?)?))
    }
}
