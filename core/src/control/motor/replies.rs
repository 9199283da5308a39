//! Counts the replies of one motor, and those that it missed.

use motord_bus::Duration;
use motord_bus::time::nanos;
use motord_protocol::drive::Command;

/// Cycles without a question for faults after a missed reply: a late reply could be mistaken for
/// the answer.
const SETTLE_CYCLES: u64 = 10;

#[derive(Debug, Default)]
pub(super) struct Replies {
    /// A question was sent in this turn whose answer is a state.
    asked: bool,
    /// The command of this turn was a stop.
    pub(super) asked_stop: bool,
    /// The command of this turn was a setpoint.
    pub(super) asked_control: bool,
    /// The command of this turn was a question for the faults.
    pub(super) asked_fault: bool,
    /// It reported its state since the command.
    answered: bool,
    /// Number of publications when its last state arrived.
    publications: Option<u64>,
    /// Consecutive turns without any answer.
    pub(super) silent: u32,
    /// Consecutive turns whose command had no answer. A late state ends a silence, but not this.
    pub(super) unanswered: u32,
    /// Turns since the last state was current; 0 if it arrived in time in the last turn.
    pub(super) age_cycles: u32,
    /// Turns without a reply since the start, modulo 2³².
    pub(super) missed: u32,
    /// Replies after their turn, modulo 2³².
    pub(super) late: u32,
    /// States that the joint cannot have had, modulo 2³².
    pub(super) implausible: u32,
    /// Time from the last answered command to its reply, ns.
    pub(super) latency_ns: u32,
    /// The cycle of the last missed reply; 0 for none.
    last_missed: u64,
    /// Turns by which all its answers are late.
    behind: u32,
}

impl Replies {
    /// Records that a command is sent. A state that is not published yet stays new.
    pub(super) const fn asked(&mut self, command: &Command) {
        self.asked = command.is_answered_by_state();
        self.asked_stop = matches!(command, Command::Stop);
        self.asked_control = matches!(command, Command::Control(_));
        self.asked_fault = matches!(command, Command::GetFault);
        self.answered = false;
    }

    /// Records that the command of this turn has no answer.
    pub(super) const fn expect_none(&mut self) {
        self.asked = false;
    }

    /// Returns whether the question of this turn has no answer of any kind yet.
    pub(super) const fn is_awaited(&self) -> bool {
        self.asked && !self.answered
    }

    /// Returns whether a state arrived in this turn.
    pub(super) const fn answered(&self) -> bool {
        self.answered
    }

    /// Records that all its answers are late by this many turns. The last state does not get
    /// younger.
    pub(super) const fn set_behind(&mut self, turns: u32) {
        self.age_cycles = self.age_cycles.saturating_add(turns.saturating_sub(self.behind));
        self.behind = turns;
    }

    /// Returns whether a state arrived since the last publication, and in time.
    #[inline]
    pub(super) const fn is_fresh(&self, publications: u64) -> bool {
        self.behind == 0 && self.is_new(publications)
    }

    /// Returns whether a state arrived since the last publication.
    pub(super) const fn is_new(&self, publications: u64) -> bool {
        matches!(self.publications, Some(before) if before == publications)
    }

    /// Records a state that arrived `latency` after the command.
    pub(super) fn state(&mut self, latency: Duration, publications: u64) {
        self.latency_ns = u32::try_from(nanos(latency)).unwrap_or(u32::MAX);
        self.answered = true;
        self.publications = Some(publications);
        (self.silent, self.age_cycles) = (0, self.behind);
    }

    /// Discards the last state: it is not published as new.
    pub(super) const fn forget(&mut self, publications: u64) {
        if self.is_new(publications) {
            self.publications = None;
            self.age_cycles = 1;
        }
    }

    /// Records another answer: no state is awaited any more.
    pub(super) const fn alive(&mut self) {
        self.asked = false;
        (self.silent, self.unanswered) = (0, 0);
    }

    /// Records a turn without a state. A state that is not published yet does not age.
    pub(super) const fn age(&mut self, publications: u64) {
        self.age_cycles = self.age_cycles.saturating_add(!self.is_new(publications) as u32);
    }

    /// Records a turn without an answer that ends in `cycle`. Returns the consecutive unanswered
    /// turns; 0 where no answer was due.
    pub(super) const fn miss(&mut self, cycle: u64) -> u32 {
        if !self.asked && self.silent == 0 {
            return 0;
        }
        (self.silent, self.unanswered) = (self.silent + 1, self.unanswered + 1);
        self.last_missed = cycle;
        if self.asked {
            self.missed = self.missed.wrapping_add(1);
        }
        self.unanswered
    }

    /// Returns whether the state of this turn has arrived by `cycle` and no late reply is expected.
    pub(super) const fn is_settled(&self, cycle: u64) -> bool {
        self.answered && (self.last_missed == 0 || cycle > self.last_missed + SETTLE_CYCLES)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seed 232 of the fault injection: answers that came turns late come in time again, and the
    /// last late state was published as current.
    #[test]
    fn last_state_does_not_get_younger() {
        let mut replies = Replies::default();
        replies.set_behind(2);
        replies.state(Duration::ZERO, 7);
        assert_eq!(replies.age_cycles, 2);
        replies.set_behind(0);
        assert_eq!((replies.age_cycles, replies.is_fresh(8)), (2, false));
        replies.state(Duration::ZERO, 9);
        assert_eq!((replies.age_cycles, replies.is_fresh(9)), (0, true));
    }
}
