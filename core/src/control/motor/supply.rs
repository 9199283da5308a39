//! The supply of a motor, as it reports it.

use super::Motor;
use core::ops::RangeInclusive;
use motord_protocol::SupplyReport;
use motord_protocol::drive::Supply;

/// The voltages that a motor may report, V.
const VOLTAGES: RangeInclusive<f32> = 0.0..=1000.0;

impl Motor {
    /// Returns the supply that it reported last.
    pub(crate) const fn supply(&self) -> Option<Supply> {
        self.supply
    }

    /// Takes the supply that it reports. One that no motor has is not known.
    pub(crate) fn record_supply(&mut self, supply: Supply) {
        self.supply = Some(supply).filter(|supply| VOLTAGES.contains(&supply.voltage));
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
            motor.record_supply(Supply { voltage: 24.0, current: None });
            motor.record_supply(Supply { voltage, current: Some(1.0) });
            assert_eq!(motor.supply(), None, "{voltage} V");
        }
    }
}
