//! What a torque code is worth.
//!
//! The 12-bit torque code carries the q-axis current, ±225 A; the documents' formulas turn it into torque at the output
//! shaft by the torque constant and the gear ratio (MIT document 1.1 and 1.2, GIM document 3.2.7). The torque constant is
//! that of the **rotor**: the one the driver holds as configuration float 0x03. Data sheets often print the constant at
//! the output shaft, which is larger by the gear ratio; used here it would make every torque wrong by that factor.

use core::fmt;

use crate::field::Field;

/// The range of the current behind a torque code, A.
pub(crate) const CURRENT: Field = Field::symmetric(12, 225.0);

/// A motor's torque range on the wire: ±225 A times torque constant times gear ratio. Most of it lies far above what the
/// motor can do, so it is no limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TorqueScale {
    field: Field,
}

impl TorqueScale {
    /// From the rotor's torque constant, N·m/A, and the gear ratio (rotor turns per turn of the output shaft).
    ///
    /// # Errors
    ///
    /// When one of them is not a positive finite number, or their product is beyond what a float can hold.
    pub fn new(torque_constant: impl Into<f64>, gear_ratio: impl Into<f64>) -> Result<Self, ScaleError> {
        let (torque_constant, gear_ratio) = (torque_constant.into(), gear_ratio.into());
        let is_positive = |value: f64| value.is_finite() && value > 0.0;
        if !is_positive(torque_constant) {
            return Err(ScaleError::TorqueConstant { received: torque_constant });
        }
        if !is_positive(gear_ratio) {
            return Err(ScaleError::GearRatio { received: gear_ratio });
        }
        let field = CURRENT.scaled([torque_constant, gear_ratio]);
        if !(field.max() as f32).is_normal() {
            return Err(ScaleError::FullScale { received: field.max() });
        }
        Ok(Self { field })
    }

    /// The torque of the largest code, N·m at the output shaft; the smallest is its negative.
    #[must_use]
    pub const fn full_scale(&self) -> f32 {
        self.field.max() as f32
    }

    /// How torque is coded, N·m at the output shaft.
    #[must_use]
    pub const fn field(&self) -> Field {
        self.field
    }
}

/// Why there is no torque scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ScaleError {
    /// The torque constant is not a positive finite number.
    TorqueConstant {
        /// What was given, N·m/A.
        received: f64,
    },
    /// The gear ratio is not a positive finite number.
    GearRatio {
        /// What was given.
        received: f64,
    },
    /// The full scale is too large or too small for a single-precision float.
    FullScale {
        /// What it would be, N·m.
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
    fn full_scale_is_225_amperes_through_torque_constant_and_gear() {
        assert_eq!(TorqueScale::new(0.1_f32, 8.0_f32).unwrap().full_scale(), 180.0);
        // A published driver of a GIM4310-36 uses 686.07 N·m: 225 A · 0.0847 N·m/A · 36.
        let full_scale = TorqueScale::new(0.0847, 36.0).unwrap().full_scale();
        assert!((full_scale - 686.07).abs() < 0.005, "{full_scale}");
    }

    #[test]
    fn a_scale_that_would_turn_torques_into_nonsense_is_refused() {
        for nonsense in [0.0, -0.1, f64::NAN, f64::INFINITY] {
            assert!(matches!(TorqueScale::new(nonsense, 8.0), Err(ScaleError::TorqueConstant { .. })));
            assert!(matches!(TorqueScale::new(0.1, nonsense), Err(ScaleError::GearRatio { .. })));
        }
        assert!(matches!(TorqueScale::new(f64::MAX, 8.0), Err(ScaleError::FullScale { .. })));
        assert!(matches!(TorqueScale::new(1e-200, 1e-200), Err(ScaleError::FullScale { .. })));
    }
}
