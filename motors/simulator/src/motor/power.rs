//! The power of a motor.

use super::configuration::int;
use super::{DISTURBANCES, Mode, Motor};
use motord_bus::Instant;

impl Motor {
    /// Returns the time from which it acknowledges frames, if nothing changes; `None` for never.
    pub(crate) fn acknowledges_from(&self) -> Option<Instant> {
        let participates = !self.impairment.off
            && !self.impairment.dead
            && self.mode != Mode::Firmware
            && self.configuration.listens_at(self.bitrate);
        participates.then_some(self.silent_until)
    }

    pub(super) fn lose_power(&mut self) {
        self.configuration.keep_int(int::POWER_OFF_POSITION, i32::from(self.encoder()));
        self.impairment.dead = true;
        self.mode = Mode::Stopped;
        self.fault = 0;
        self.end_control();
    }

    pub(super) fn boot(&mut self, at: Instant) {
        self.impairment.dead = false;
        self.disturbances = DISTURBANCES;
        self.configuration.boot();
        self.private.boot();
        self.find_turn();
        self.move_origin(self.origin + self.settings.zero_shift);
        self.silent_until = at + self.settings.boot_time;
        self.begin_reports(self.silent_until);
    }
}
