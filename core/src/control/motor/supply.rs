//! The supply of a motor, as it reports it.

use super::Motor;
use core::ops::RangeInclusive;
use motord_bus::{Duration, Instant};
use motord_protocol::SupplyReport;
use motord_protocol::drive::Supply;

/// The voltages that a motor may report, V. A request that is taken for its answer has 0.
const VOLTAGES: RangeInclusive<f32> = 1.0..=1000.0;
/// An older report says nothing about the supply.
const AGE_MAX: Duration = Duration::from_secs(3);

impl Motor {
    /// Returns the supply that it reported in the last seconds before `now`.
    pub(crate) fn supply(&self, now: Instant) -> Option<Supply> {
        self.supply.filter(|(_, at)| now.since(*at) <= AGE_MAX).map(|(supply, _)| supply)
    }

    /// Takes the supply that it reports at `now`. One that no motor has is not known.
    pub(crate) fn record_supply(&mut self, supply: Supply, now: Instant) {
        self.supply = Some((supply, now)).filter(|(supply, _)| VOLTAGES.contains(&supply.voltage));
    }

    /// Returns whether it may be asked for an indicator or its supply now. An answer about the supply
    /// names its question, so no state has to precede it.
    pub(crate) fn may_be_polled(&self, cycle: u64) -> bool {
        let is_named = self.settings.capabilities.supply == SupplyReport::Question;
        let may_be_polled = self.request.is_none() && !self.is_held() && self.measured.is_some();
        if is_named { may_be_polled } else { self.may_be_asked(cycle) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::motor::Turn;

    #[test]
    fn supply_that_no_motor_has_is_unknown() {
        let text = "[[bus]]\nname = 'a'\ntype = 'simulated'\n[[motor]]\nname = 'hip'\nbus = 'a'\nid = 1\n\
                    protocol = 'cansimple'\nmodel = 'GIM6010-8'\n";
        let settings = motord_harness::robot::settings(text);
        let mut motor = Motor::new(0, &settings.motors[0], Turn::EACH_CYCLE);
        for voltage in [f32::NAN, f32::INFINITY, -0.1, 1e9] {
            motor.record_supply(Supply { voltage: 24.0, current: None }, Instant::ZERO);
            motor.record_supply(Supply { voltage, current: Some(1.0) }, Instant::ZERO);
            assert_eq!(motor.supply(Instant::ZERO), None, "{voltage} V");
        }
        motor.record_supply(Supply { voltage: 24.0, current: None }, Instant::ZERO);
        let known =
            [3, 4].map(|seconds| motor.supply(Instant::from_nanos(seconds * 1_000_000_000)).is_some());
        assert_eq!(known, [true, false], "it is forgotten");
    }
}
