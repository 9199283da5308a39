//! The heat of a winding, from the torque it gave: an I²t model, for many drives report no temperature.
//!
//! Loss goes with the square of the torque. In a measure where the rated torque, given for good, ends at 1, the heat
//! follows d heat / dt = ((torque / rated)² − heat) / time constant, and the torque that may be given follows the heat:
//!
//! ```text
//!   limit ────────────────╮
//!                          ╲
//!   rated                    ╲────────
//!         0              0.8   1        heat
//! ```

use crate::settings::MotorSettings;

/// Heat above which the permitted torque falls.
const KNEE: f64 = 0.8;
/// Beyond it the winding is warmer than any torque that was allowed makes it: something else warms it, or the motor does
/// not do as it is commanded.
const OVERHEATED: f64 = 1.2;
/// Twice the rated torque warms a cold winding to 1 within this part of the time constant: ln(4/3), by the equation.
const TWICE_RATED: f64 = 0.287_682_072_451_781;

/// The heat of one winding, and its limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Heat {
    value: f64,
    /// The torque that it can give for good, N·m.
    rated: f32,
    /// The most torque that it can give, N·m.
    peak: f32,
    /// s.
    time_constant: f64,
}

impl Heat {
    /// A cold winding.
    pub(super) fn of(settings: &MotorSettings) -> Self {
        Self {
            value: 0.0,
            rated: settings.rated_torque,
            peak: settings.peak_torque,
            time_constant: settings.overload.as_secs_f64() / TWICE_RATED,
        }
    }

    /// `torque`, N·m, was given for `elapsed`, s. Readings above peak torque are clamped to it.
    pub(super) fn warm(&mut self, torque: f32, elapsed: f64) {
        let torque = if torque.abs() < self.peak { torque } else { self.peak };
        let loss = f64::from(torque / self.rated).powi(2);
        // Implicit, so that no elapsed time, however long, leads beyond the loss.
        self.value += (loss - self.value) * elapsed / (self.time_constant + elapsed);
    }

    /// The torque that may be given now, of at most `limit`, N·m.
    pub(super) fn allowed(&self, limit: f32) -> f32 {
        if self.value <= KNEE {
            return limit;
        }
        let share = ((1.0 - self.value) / (1.0 - KNEE)).clamp(0.0, 1.0) as f32;
        limit.min(self.rated + (limit - self.rated).max(0.0) * share)
    }

    /// It is warmer than what was allowed can have made it.
    pub(super) fn is_overheated(&self) -> bool {
        self.value > OVERHEATED
    }
}

#[cfg(test)]
#[path = "../../../tests/unit/heat.rs"]
mod tests;
