//! The tracking error of a joint.

use serde::{Deserialize, Serialize};

/// Sums up the tracking error of one joint.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Tracking {
    /// Number of samples.
    pub(crate) samples: u64,
    /// Sum of the squared errors, rad².
    squares: f64,
    /// Largest distance, rad.
    pub(crate) max: f64,
}

impl Tracking {
    /// Counts a cycle with the measured and the applied position, rad.
    pub(crate) fn count(&mut self, measured: f32, applied: f32) {
        let error = f64::from(measured) - f64::from(applied);
        self.samples += 1;
        self.squares += error * error;
        self.max = self.max.max(error.abs());
    }

    /// Returns the root of the mean squared error, rad; NaN without samples.
    pub(crate) fn rms(&self) -> f64 {
        (self.squares / self.samples as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_error_rms_is_amplitude_over_root_two() {
        let mut tracking = Tracking::default();
        for step in 0..1000_u16 {
            tracking.count((f32::from(step) * std::f32::consts::TAU / 1000.0).sin(), 0.0);
        }
        assert!((tracking.rms() - 0.5_f64.sqrt()).abs() < 1e-6);
        assert!((tracking.max - 1.0).abs() < 1e-6);
    }

    #[test]
    fn unseen_joint_has_no_tracking_error() {
        assert!(Tracking::default().rms().is_nan());
    }
}
