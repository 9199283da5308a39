//! The scales of a motor, with the constants that they were computed from.

use motord_protocol::{Model, Profile, ScaleError, Scales};

/// The scales of a motor whose torque code is known.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scale {
    /// The rotor's torque constant, N·m/A, and the gear ratio, where the scales follow from them.
    pub(super) constants: Option<[f64; 2]>,
    pub(super) scales: Scales,
}

impl Scale {
    pub(super) fn new(torque_constant: f64, gear_ratio: f64) -> Result<Self, ScaleError> {
        let scales = Scales::by_current(torque_constant, gear_ratio)?;
        Ok(Self { constants: Some([torque_constant, gear_ratio]), scales })
    }

    /// Returns the scales of a model. The constants count only where its torque code is a current.
    pub(super) fn of_model(model: &Model, torque_constant: f64, gear_ratio: f64) -> Result<Self, ScaleError> {
        let constants = model.ends.is_none().then_some([torque_constant, gear_ratio]);
        Ok(Self { constants, scales: model.scales_with(torque_constant, gear_ratio)? })
    }
}

/// Returns the scales that all motors of `profile` share, apart from the torque.
pub(super) fn common(profile: &Profile) -> Option<Scales> {
    let first = profile.models.first()?.ends;
    profile.models.iter().all(|model| model.ends == first).then(|| match first {
        Some(ends) => Some(Scales::of(&ends)),
        None => Scales::by_current(1.0, 1.0).ok(),
    })?
}
