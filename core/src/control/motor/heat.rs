//! Models the heat of a winding from its torque (I²t), because many drives report no temperature.
//!
//! The loss is proportional to the square of the torque. The unit of heat is the steady state at
//! rated torque: d heat / dt = ((torque / rated)² − heat) / time constant. The allowed torque
//! follows the heat:
//!
//! ```text
//!   limit ────────────────╮
//!                          ╲
//!   rated                    ╲────────
//!         0              0.8   1        heat
//! ```

use motord_settings::settings::MotorSettings;

/// Heat above which the permitted torque falls.
const KNEE: f64 = 0.8;
/// No allowed torque heats the winding beyond this value: it has another source of heat, or the
/// motor does not follow its commands.
const OVERHEATED: f64 = 1.2;
/// Twice the rated torque warms a cold winding to 1 within this part of the time constant: ln(4/3),
/// by the equation.
const TWICE_RATED: f64 = 0.287_682_072_451_781;

/// The heat of one winding, and its limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Heat {
    value: f64,
    /// Continuous torque, N·m.
    rated: f32,
    /// Highest torque, N·m.
    peak: f32,
    /// s.
    time_constant: f64,
}

impl Heat {
    /// Creates a cold winding.
    pub(super) fn of(settings: &MotorSettings) -> Self {
        Self {
            value: 0.0,
            rated: settings.winding.rated_torque,
            peak: settings.winding.peak_torque,
            time_constant: settings.winding.overload.as_secs_f64() / TWICE_RATED,
        }
    }

    /// Adds the heat of `torque`, N·m, during `elapsed`, s. Clamps readings to the peak torque.
    pub(super) fn warm(&mut self, torque: f32, elapsed: f64) {
        let torque = if torque.abs() < self.peak { torque } else { self.peak };
        let loss = f64::from(torque / self.rated).powi(2);
        // Implicit integration: no elapsed time leads beyond the loss.
        self.value += (loss - self.value) * elapsed / (self.time_constant + elapsed);
    }

    /// Returns the allowed torque, at most `limit`, N·m.
    pub(super) fn allowed(&self, limit: f32) -> f32 {
        if self.value <= KNEE {
            return limit;
        }
        let share = ((1.0 - self.value) / (1.0 - KNEE)).clamp(0.0, 1.0) as f32;
        limit.min(self.rated + (limit - self.rated).max(0.0) * share)
    }

    /// Returns whether the winding is hotter than allowed torques can heat it.
    pub(super) fn is_overheated(&self) -> bool {
        self.value > OVERHEATED
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATED: f32 = 7.5;
    const LIMIT: f32 = 20.0;
    /// Twice the rated torque for ten seconds.
    const COLD: Heat = Heat { value: 0.0, rated: RATED, peak: 22.0, time_constant: 10.0 / TWICE_RATED };
    const CYCLE: f64 = 1e-3;

    /// Applies `wanted` for `seconds`, limited to the allowed torque. Returns the last allowed
    /// torque.
    fn give(heat: &mut Heat, wanted: f32, seconds: u32) -> f32 {
        for _ in 0..seconds * 1000 {
            heat.warm(wanted.min(heat.allowed(LIMIT)), CYCLE);
        }
        heat.allowed(LIMIT)
    }

    #[test]
    fn rated_torque_is_sustained_and_zero_torque_cools() {
        let mut heat = COLD;
        assert!(give(&mut heat, RATED, 1000) >= RATED);
        assert!(heat.value <= 1.0 && !heat.is_overheated());
        give(&mut heat, 0.0, 100);
        assert!(heat.value < 0.1, "{heat:?}");
        assert_eq!(heat.allowed(LIMIT), LIMIT);
    }

    #[test]
    fn twice_rated_torque_heats_in_configured_time() {
        let mut heat = COLD;
        for _ in 0..10_000 {
            heat.warm(2.0 * RATED, CYCLE);
        }
        assert!((heat.value - 1.0).abs() < 1e-3, "{heat:?}");
    }

    #[test]
    fn excess_torque_falls_to_rated_without_overheating() {
        let mut heat = COLD;
        assert!(give(&mut heat, 2.0 * RATED, 5) >= 2.0 * RATED, "for a while it is allowed");
        assert!(
            give(&mut heat, 2.0 * RATED, 5) < 2.0 * RATED,
            "not as long as a winding without a model would take"
        );
        assert!(give(&mut heat, LIMIT, 20) < 1.01 * RATED);
        assert!(heat.value <= 1.0, "{heat:?}");
    }

    #[test]
    fn impossible_torque_heats_as_much_as_peak() {
        let [mut reported, mut given] = [COLD; 2];
        for _ in 0..50 {
            reported.warm(-225.0, CYCLE);
            given.warm(22.0, CYCLE);
        }
        assert_eq!(reported, given);
        assert!(reported.value < 0.05, "garbage for 50 ms is no heat: {reported:?}");
    }

    #[test]
    fn limit_below_rated_torque_stays_the_limit() {
        let mut heat = COLD;
        for _ in 0..100 {
            heat.warm(10.0 * RATED, 1.0);
        }
        assert!(heat.is_overheated());
        assert_eq!(heat.allowed(5.0), 5.0);
    }
}
