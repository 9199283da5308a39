//! Commands that a motor does not answer, or answers without its state.

use super::Motor;
use super::mode::Mode;

/// Largest age of a state that a motor sends by itself, cycles: three intervals at 1 kHz.
const RARE_AGE_MAX: u32 = 30;

impl Motor {
    /// Returns whether its states arrive at intervals of several cycles, because it is not enabled.
    pub(super) const fn reports_rarely(&self) -> bool {
        self.settings.capabilities.reports_stopped_state
            && !matches!(self.mode, Mode::Active | Mode::Damping { .. })
    }

    /// Returns whether a state arrived in the previous or the current turn; from a motor that reports
    /// rarely, in the last ones.
    pub(crate) const fn is_fresh(&self) -> bool {
        let most = if self.reports_rarely() { RARE_AGE_MAX } else { 1 };
        self.measured.is_some() && self.replies.age_cycles <= most
    }

    /// Records that the command of this turn has no answer: none is missed. The next probe of an
    /// offline motor does not wait.
    pub(crate) const fn expect_no_answer(&mut self) {
        self.replies.expect_none();
        self.hurry_probe();
    }

    /// Makes the next probe of an offline motor due in the next cycle, also on a held bus: a frame that
    /// is answered does not wait.
    pub(in crate::control) const fn hurry_probe(&mut self) {
        if let Mode::Offline(probe) = &mut self.mode {
            probe.hurry();
            self.access.hurry();
        }
    }
}
