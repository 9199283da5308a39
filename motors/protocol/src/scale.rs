//! The scales of the codes of one motor: the ranges of position, velocity, stiffness, damping and
//! torque.
//!
//! SteadyWin's 12-bit torque code is the q-axis current, ±225 A. The documents' formulas convert it
//! to torque at the output shaft (MIT document 1.1 and 1.2, GIM document 3.2.7). They use the
//! torque constant and the gear ratio. The torque constant is that of the **rotor**, which the
//! driver stores as configuration float 0x03. Data sheets often print the constant at the output
//! shaft, which is larger by the gear ratio. With it, every torque would be wrong by that factor.
//! Other vendors fix the ranges by model, or store them in registers.

use core::fmt;

use crate::field::Field;

/// Position of a SteadyWin motor's output shaft, rad, 16 bits.
const POSITION: Field = Field::symmetric(16, 12.5);
/// Velocity of a SteadyWin motor's output shaft, rad/s, 12 bits.
const VELOCITY: Field = Field::symmetric(12, 65.0);
/// The largest stiffness, N·m/rad, and damping, N·m·s/rad, that the codes of most motors can have.
const GAIN_ENDS: [f64; 2] = [500.0, 5.0];
/// Range of the current that a SteadyWin torque code stands for, A.
const CURRENT: Field = Field::symmetric(12, 225.0);

/// The values of the largest codes of one motor, all finite and above zero. The smallest codes of
/// the first three stand for the negatives, those of the gains for zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ends {
    /// rad.
    pub position: f64,
    /// rad/s.
    pub velocity: f64,
    /// N·m.
    pub torque: f64,
    /// Stiffness, N·m/rad.
    pub kp: f64,
    /// Damping, N·m·s/rad.
    pub kd: f64,
}

impl Ends {
    /// Returns the ends of a motor with the gains of most motors: 500 N·m/rad and 5 N·m·s/rad.
    #[must_use]
    pub const fn new(position: f64, velocity: f64, torque: f64) -> Self {
        let [kp, kd] = GAIN_ENDS;
        Self { position, velocity, torque, kp, kd }
    }

    /// Returns these ends with other ones of the gains, N·m/rad and N·m·s/rad.
    #[must_use]
    pub const fn with_gains(self, kp: f64, kd: f64) -> Self {
        Self { kp, kd, ..self }
    }
}

/// Encoding of one motor's quantities, in both directions. The range of the torque may far exceed
/// the motor's ability, so it is not a limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scales {
    /// Position of the output shaft, rad, 16 bits.
    pub position: Field,
    /// Velocity of the output shaft, rad/s, 12 bits.
    pub velocity: Field,
    /// Stiffness, N·m/rad, 12 bits.
    pub kp: Field,
    /// Damping, N·m·s/rad, 12 bits.
    pub kd: Field,
    /// Torque at the output shaft, N·m, 12 bits.
    pub torque: Field,
}

impl Scales {
    /// Returns the scales of a SteadyWin motor, from the rotor's torque constant (N·m/A) and the
    /// gear ratio (rotor turns per turn of the output shaft). The torque codes span ±225 A times
    /// both.
    ///
    /// # Errors
    ///
    /// When one of them is not a positive finite number, or the full scale is too large or too
    /// small for a single-precision float.
    pub fn by_current(
        torque_constant: impl Into<f64>,
        gear_ratio: impl Into<f64>,
    ) -> Result<Self, ScaleError> {
        let (torque_constant, gear_ratio) = (torque_constant.into(), gear_ratio.into());
        if !is_positive(torque_constant) {
            return Err(ScaleError::TorqueConstant { received: torque_constant });
        }
        if !is_positive(gear_ratio) {
            return Err(ScaleError::GearRatio { received: gear_ratio });
        }
        let torque = CURRENT.scaled([torque_constant, gear_ratio]);
        if !(torque.max() as f32).is_normal() {
            return Err(ScaleError::FullScale { received: torque.max() });
        }
        Ok(Self { torque, ..Self::of(&Ends::new(POSITION.max(), VELOCITY.max(), CURRENT.max())) })
    }

    /// Scales of a SteadyWin motor with unknown constants: torques are fractions of the full scale.
    pub const WITHOUT_CONSTANTS: Self = Self::of(&Ends::new(12.5, 65.0, 1.0));

    /// Returns the scales of a motor with these ends of its codes.
    #[must_use]
    pub const fn of(ends: &Ends) -> Self {
        Self {
            position: Field::symmetric(16, ends.position),
            velocity: Field::symmetric(12, ends.velocity),
            kp: Field::new(12, 0.0, ends.kp),
            kd: Field::new(12, 0.0, ends.kd),
            torque: Field::symmetric(12, ends.torque),
        }
    }

    /// Returns the ends of the codes.
    #[must_use]
    pub const fn ends(&self) -> Ends {
        Ends {
            position: self.position.max(),
            velocity: self.velocity.max(),
            torque: self.torque.max(),
            kp: self.kp.max(),
            kd: self.kd.max(),
        }
    }

    /// Returns the scales with these ends of position, rad, velocity, rad/s, and torque, N·m: those
    /// that a motor's registers contain. The gains keep theirs.
    #[must_use]
    pub fn with_ends(&self, ends: [f32; 3]) -> Self {
        let [position, velocity, torque] = ends.map(f64::from);
        Self::of(&Ends { position, velocity, torque, ..self.ends() })
    }

    /// Returns the torque of the largest code, N·m at the output shaft. The smallest code stands
    /// for its negative.
    #[must_use]
    pub const fn full_scale(&self) -> f32 {
        self.torque.max() as f32
    }
}

fn is_positive(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

/// Reason for which there is no torque scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ScaleError {
    /// The torque constant is not a positive finite number.
    TorqueConstant {
        /// The given value, N·m/A.
        received: f64,
    },
    /// The gear ratio is not a positive finite number.
    GearRatio {
        /// The given value.
        received: f64,
    },
    /// The full scale is too large or too small for a single-precision float.
    FullScale {
        /// The full scale that the constants give, N·m.
        received: f64,
    },
}

impl fmt::Display for ScaleError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TorqueConstant { received } => {
                write!(f, "torque constant {received} N·m/A, expected a positive number")
            }
            Self::GearRatio { received } => write!(f, "gear ratio {received}, expected a positive number"),
            Self::FullScale { received } => {
                write!(f, "torque full scale {received:e} N·m, expected a single-precision number")
            }
        }
    }
}

impl core::error::Error for ScaleError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_scale_is_225_amperes_through_gear() {
        assert_eq!(Scales::by_current(0.1_f32, 8.0_f32).unwrap().full_scale(), 180.0);
        // A published driver of a GIM4310-36 uses 686.07 N·m: 225 A · 0.0847 N·m/A · 36.
        let full_scale = Scales::by_current(0.0847, 36.0).unwrap().full_scale();
        assert!((full_scale - 686.07).abs() < 0.005, "{full_scale}");
    }

    #[test]
    fn nonsensical_scale_is_refused() {
        for nonsense in [0.0, -0.1, f64::NAN, f64::INFINITY] {
            assert!(matches!(Scales::by_current(nonsense, 8.0), Err(ScaleError::TorqueConstant { .. })));
            assert!(matches!(Scales::by_current(0.1, nonsense), Err(ScaleError::GearRatio { .. })));
        }
        assert!(matches!(Scales::by_current(f64::MAX, 8.0), Err(ScaleError::FullScale { .. })));
        assert!(matches!(Scales::by_current(1e-200, 1e-200), Err(ScaleError::FullScale { .. })));
    }
}
