//! The vendors' data of each motor. They are defaults: a configuration must be able to override
//! every value.
//!
//! Source of the GIM series: the SteadyWin selection table (steadywin-motor.com), the winding named
//! by its voltage. Other windings and drivers of the same name differ by up to a factor of two. The
//! table lacks the rotor's torque constant. It is estimated as peak torque / peak current / gear
//! ratio. The published constants are those of the output shaft, and some of them contradict the
//! rest of their row. Before you rely on torques, compare with the stored values of the motor
//! ([`ConfigurationItem::TORQUE_CONSTANT`](crate::gim::ConfigurationItem::TORQUE_CONSTANT) and
//! `GEAR_RATIO`).

use crate::scale::{Ends, ScaleError, Scales};

/// A motor. Torques and velocities are those of the output shaft.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Model {
    /// The vendor's name.
    pub name: &'static str,
    /// Rotor turns per turn of the output shaft.
    pub gear_ratio: f32,
    /// Torque constant of the rotor, N·m/A.
    pub torque_constant: f32,
    /// Highest continuous torque, N·m.
    pub rated_torque: f32,
    /// Highest short-time torque, N·m.
    pub peak_torque: f32,
    /// Current at rated torque, A.
    pub rated_current: f32,
    /// Current at peak torque, A.
    pub peak_current: f32,
    /// Highest velocity, rad/s.
    pub max_velocity: f32,
    /// Resistance of the winding from phase to phase, Ω.
    pub phase_resistance: f32,
    /// Pairs of poles of the rotor.
    pub pole_pairs: u8,
    /// Voltage at which the torques and velocities apply, V.
    pub rated_voltage: f32,
    /// The ends of the codes; `None` where the torque code is SteadyWin's current.
    pub ends: Option<Ends>,
    /// Inertia of the rotor alone, kg·m²; `None` where the vendor publishes none.
    pub rotor_inertia: Option<f32>,
}

/// The constants that a SteadyWin motor stores (GIM document, table 7).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveConstants {
    /// Torque constant of the rotor, N·m/A (ConfID 0x03).
    pub torque_constant: f64,
    /// Rotor turns per turn of the output shaft (ConfID 0x11).
    pub gear_ratio: f64,
    /// Pairs of poles of the rotor (ConfID 0x00).
    pub pole_pairs: u8,
}

impl DriveConstants {
    /// Returns the constants that a motor of this model has from the factory.
    #[must_use]
    pub fn of(model: &Model) -> Self {
        Self {
            torque_constant: model.torque_constant.into(),
            gear_ratio: model.gear_ratio.into(),
            pole_pairs: model.pole_pairs,
        }
    }
}

#[expect(clippy::too_many_arguments, reason = "a row of the table below, in the order of its columns")]
pub(crate) const fn model(
    name: &'static str,
    gear_ratio: f32,
    torque_constant: f32,
    [rated_torque, peak_torque]: [f32; 2],
    [rated_current, peak_current]: [f32; 2],
    max_velocity: f32,
    phase_resistance: f32,
    pole_pairs: u8,
    rated_voltage: f32,
) -> Model {
    Model {
        name,
        gear_ratio,
        torque_constant,
        rated_torque,
        peak_torque,
        rated_current,
        peak_current,
        max_velocity,
        phase_resistance,
        pole_pairs,
        rated_voltage,
        ends: None,
        rotor_inertia: None,
    }
}

/// Name, gear ratio, rotor torque constant, torque rated and peak, current rated and peak,
/// velocity, resistance, pole pairs, voltage.
#[expect(clippy::approx_constant, reason = "6.28 N·m is a torque")]
pub const MODELS: [Model; 19] = [
    model("GIM3505-8", 8.0, 0.056, [0.67, 1.79], [1.53, 3.99], 41.9, 5.47, 11, 24.0),
    model("GIM3510-8", 8.0, 0.027, [1.0, 6.28], [3.3, 28.9], 61.6, 0.515, 7, 24.0),
    model("GIM4305-10", 10.0, 0.026, [1.05, 3.82], [2.18, 15.0], 42.1, 1.11, 14, 24.0),
    model("GIM4310-10", 10.0, 0.075, [1.63, 7.98], [1.3, 10.7], 22.2, 1.96, 14, 24.0),
    model("GIM4310-36", 36.0, 0.067, [6.24, 25.4], [1.83, 10.6], 6.7, 1.86, 14, 24.0),
    model("GIM4315-8", 8.0, 0.091, [1.6, 14.3], [1.86, 19.5], 42.4, 1.5, 14, 24.0),
    model("GIM6010-6", 6.0, 0.057, [3.3, 8.0], [9.7, 23.5], 47.1, 0.55, 14, 24.0),
    model("GIM6010-8", 8.0, 0.059, [5.0, 11.0], [10.5, 23.4], 44.0, 0.44, 14, 24.0),
    model("GIM6010-36", 36.0, 0.122, [18.0, 41.0], [4.6, 9.3], 10.2, 0.6, 14, 48.0),
    model("GIM6010-48", 48.0, 0.086, [27.0, 55.9], [6.5, 13.5], 5.1, 0.42, 14, 24.0),
    model("GIM8108-6", 6.0, 0.093, [5.18, 26.3], [4.65, 47.4], 39.0, 0.774, 21, 48.0),
    model("GIM8108-8", 8.0, 0.125, [7.5, 22.0], [7.0, 22.0], 33.5, 0.67, 21, 48.0),
    model("GIM8108-9", 9.0, 0.154, [8.19, 27.4], [4.0, 19.8], 25.3, 0.73, 21, 48.0),
    model("GIM8108-36", 36.0, 0.154, [32.8, 109.5], [4.0, 19.8], 6.3, 0.72, 21, 48.0),
    model("GIM8108-48", 48.0, 0.138, [35.5, 133.5], [4.41, 20.2], 5.3, 0.735, 21, 48.0),
    model("GIM8115-6", 6.0, 0.139, [8.59, 36.9], [8.1, 44.3], 20.8, 0.364, 21, 24.0),
    model("GIM8115-9", 9.0, 0.18, [13.0, 40.0], [7.9, 24.7], 13.5, 0.28, 21, 24.0),
    model("GIM8115-36", 36.0, 0.179, [45.6, 132.0], [6.8, 20.5], 3.4, 0.98, 21, 24.0),
    model("GIM10015-9", 9.0, 0.228, [30.0, 62.1], [14.2, 30.2], 10.9, 0.28, 21, 24.0),
];

impl Model {
    /// Returns the model with codes that end at these values: position, rad, velocity, rad/s,
    /// torque, N·m.
    #[must_use]
    pub const fn with_ends(self, position: f64, velocity: f64, torque: f64) -> Self {
        Self { ends: Some(Ends::new(position, velocity, torque)), ..self }
    }

    /// Returns the model with gain codes that end at these values, N·m/rad and N·m·s/rad. No effect
    /// on a model without ends.
    #[must_use]
    pub const fn with_gain_ends(self, kp: f64, kd: f64) -> Self {
        match self.ends {
            Some(ends) => Self { ends: Some(ends.with_gains(kp, kd)), ..self },
            None => self,
        }
    }

    /// Returns the model with a rotor of this inertia, kg·m².
    #[must_use]
    pub const fn with_rotor_inertia(self, rotor_inertia: f32) -> Self {
        Self { rotor_inertia: Some(rotor_inertia), ..self }
    }

    /// Returns the scales by the model's own constants.
    ///
    /// # Errors
    ///
    /// Never for a known model, which a test verifies.
    pub fn scales(&self) -> Result<Scales, ScaleError> {
        self.scales_with(self.torque_constant.into(), self.gear_ratio.into())
    }

    /// Returns the scales of such a motor with this rotor torque constant, N·m/A, and gear ratio.
    /// They have an effect only where the torque code is a current.
    ///
    /// # Errors
    ///
    /// When the torque code is a current and the constants are invalid: see [`Scales::by_current`].
    pub fn scales_with(&self, torque_constant: f64, gear_ratio: f64) -> Result<Scales, ScaleError> {
        match self.ends {
            Some(ends) => Ok(Scales::of(&ends)),
            None => Scales::by_current(torque_constant, gear_ratio),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn model_is_found_by_name_with_gear_ratio() {
        for model in &MODELS {
            let (_, ratio) = model.name.split_once('-').unwrap();
            assert_eq!(ratio.parse(), Ok(model.gear_ratio));
            assert_eq!(Model::by_name(model.name), Some(model));
        }
        assert_eq!(Model::by_name("gim8108-8").map(|model| model.name), Some("GIM8108-8"));
        assert_eq!(Model::by_name("GIM8108"), None);
    }

    #[test]
    fn every_models_peak_current_gives_its_peak_torque() {
        for model in &MODELS {
            let torque = model.peak_current * model.torque_constant * model.gear_ratio;
            assert!((torque / model.peak_torque - 1.0).abs() < 0.05, "{}: {torque} N·m", model.name);
        }
    }

    #[test]
    fn peak_torque_and_velocity_lie_within_code_ends() {
        for model in crate::profile::PROFILES.iter().flat_map(|profile| profile.models) {
            let ends = model.scales().unwrap().ends();
            assert!(f64::from(model.peak_torque) <= ends.torque, "{}", model.name);
            assert!(f64::from(model.max_velocity) <= ends.velocity, "{}", model.name);
            assert!(model.rated_torque < model.peak_torque, "{}", model.name);
        }
    }
}
