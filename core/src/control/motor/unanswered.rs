//! Turns without a state: commands that a motor does not answer, or answers without it.

use super::Motor;
use super::mode::Mode;
use crate::control::context::Context;

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

    /// Ends a turn without a state. Returns whether the motor is lost.
    #[cold]
    pub(super) fn end_unanswered_turn(&mut self, cx: &mut Context) -> bool {
        self.replies.age(cx.publications);
        let is_explained = self.replies.is_awaited() && self.explains_gap(cx);
        let counts = !matches!(self.mode, Mode::Offline(_) | Mode::Excluded(_)) && self.request.is_none();
        // It answers, but reports no state while it should move: it refuses its commands.
        let lost_cycles = if self.is_held() { 1 } else { cx.safety.lost_cycles };
        let blind = self.mode.is_moving() && !self.reports_rarely() && self.replies.age_cycles >= lost_cycles;
        let misses = counts && !is_explained;
        let lost = blind
            || counts && self.reports_no_more(lost_cycles)
            || misses && self.miss(cx) >= lost_cycles
            || self.is_too_late();
        if lost {
            self.lose(cx);
        }
        lost
    }

    /// Returns whether a motor that only reports is silent: it has no answer to miss.
    const fn reports_no_more(&self, lost_cycles: u32) -> bool {
        self.settings.capabilities.only_reports && self.replies.age_cycles >= lost_cycles
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
