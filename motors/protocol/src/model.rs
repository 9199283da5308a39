//! The vendors' data of each motor. They are defaults: a configuration must be able to override
//! every value.

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
    /// Current at rated torque, A; 0 where it is not published.
    pub rated_current: f32,
    /// Current at peak torque, A; 0 where it is not published.
    pub peak_current: f32,
    /// Highest velocity, rad/s.
    pub max_velocity: f32,
    /// Resistance of the winding from phase to phase, Ω; 0 where it is not published.
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

impl Model {
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
