//! The constants behind a torque code, kept as they were given so that an object can tell them.

use crate::frame::object::Object;
use crate::frame::refused::Refused;
use motord_protocol::{ScaleError, TorqueScale};

/// The torque constant and the gear ratio, and what follows from them.
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

    pub(super) fn tell(&self, object: &mut Object) {
        object.insert("torque_constant", self.torque_constant);
        object.insert("gear_ratio", self.gear_ratio);
    }

    /// The constants in `object`, if it tells them.
    pub(super) fn of(object: &Object) -> Result<Option<Self>, Refused> {
        if !object.has("torque_constant") && !object.has("gear_ratio") {
            return Ok(None);
        }
        Ok(Some(Self::new(object.number("torque_constant")?, object.number("gear_ratio")?)?))
    }
}

/// The torque scale; any, where torques are told by their codes alone.
pub(super) fn torque_or_any(scale: Option<&Scale>) -> Result<TorqueScale, ScaleError> {
    scale.map_or_else(|| TorqueScale::new(1.0, 1.0), |scale| Ok(scale.torque))
}
