//! The ranges of the codes of a motor.

use serde::Deserialize;

/// Values of the largest codes. Position, velocity and torque are symmetric; stiffness and damping
/// begin at 0.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ranges {
    /// Largest position, rad, of 65 535 codes.
    #[serde(rename = "position-rad")]
    pub position: f64,
    /// Largest velocity, rad/s, of 4095 codes.
    #[serde(rename = "velocity-rad-s")]
    pub velocity: f64,
    /// Largest stiffness, N·m/rad, of 4095 codes.
    pub kp: f64,
    /// Largest damping, N·m·s/rad, of 4095 codes.
    pub kd: f64,
    /// Largest torque, N·m, of 4095 codes.
    #[serde(rename = "torque-nm")]
    pub torque: f64,
}

impl Ranges {
    /// Returns SteadyWin's ranges: 12.5 rad, 65 rad/s, 500 N·m/rad, 5 N·m·s/rad, and the model's
    /// torque (MIT document 1.1).
    #[must_use]
    pub const fn steadywin(torque: f64) -> Self {
        Self { position: 12.5, velocity: 65.0, kp: 500.0, kd: 5.0, torque }
    }

    /// Returns the size of one code in each field.
    #[must_use]
    pub const fn codes(&self) -> Self {
        Self {
            position: 2.0 * self.position / 65535.0,
            velocity: 2.0 * self.velocity / 4095.0,
            kp: self.kp / 4095.0,
            kd: self.kd / 4095.0,
            torque: 2.0 * self.torque / 4095.0,
        }
    }
}
