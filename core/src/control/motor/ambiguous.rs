//! The part of a motor that asks for its faults beside the regular questions: after a silence, a
//! refusal or an ambiguous answer.

use super::Motor;
use super::mode::Mode;
use crate::control::context::Context;
use motord_bus::Instant;
use motord_protocol::Faults;

/// A motor that has been silent for this many turns is asked for its faults instead.
const SILENT_TURNS: u32 = 5;

impl Motor {
    /// Returns whether a question for faults replaces the command. A motor in fault may answer
    /// nothing else (GIM document 3.2.16), so a silent motor is asked at intervals. Never in two
    /// consecutive turns: a moving motor needs its commands.
    pub(super) const fn needs_fault_request(&mut self) -> bool {
        if self.replies.asked_fault {
            return false;
        }
        let silent = self.replies.silent > 0 && self.replies.silent.is_multiple_of(SILENT_TURNS);
        let urgent = core::mem::replace(&mut self.faults.is_urgent, false);
        let requests = (urgent || silent && !matches!(self.mode, Mode::Offline(_))) && !self.is_excluded();
        requests && self.settings.capabilities.answers_fault_question
    }

    /// Records an answer that may be its fault bits. If they are not the known ones, it is asked
    /// again in its turn after next: a state in between shows whether the answer was a late one.
    #[cold]
    pub(in crate::control) fn record_ambiguous(&mut self, fault: Faults, at: Instant, cx: &Context) {
        self.faults.postpone(at, cx);
        if fault != self.faults.reported {
            (self.faults.is_urgent, self.replies.asked_fault) = (true, true);
        }
    }
}
