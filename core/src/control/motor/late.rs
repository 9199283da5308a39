//! The part of a motor that knows how late its answers are.

use super::Motor;
use super::backlog::Backlog;
use super::mode::Mode;
use crate::control::Event;
use crate::control::context::Context;
use motord_bus::{Duration, Instant};

impl Motor {
    /// Begins a turn while its backlog is due. Returns whether the command of this turn is omitted.
    /// Never the first one of a mode: a stop is not delayed.
    #[cold]
    pub(super) fn probes(&mut self, cx: &mut Context) -> bool {
        let repeats = match self.mode {
            Mode::Active => self.replies.asked_control,
            Mode::Idle => self.replies.asked_stop,
            _ => false,
        };
        let may = repeats && self.replies.answered() && self.request.is_none();
        let before = self.backlog.turns();
        let omits = self.backlog.begin_turn(cx.now, may);
        self.shift(before, cx);
        omits
    }

    /// Ends a turn without a state. Returns whether its missing reply belongs to the omitted
    /// command.
    pub(super) fn explains_gap(&mut self, cx: &mut Context) -> bool {
        let before = self.backlog.turns();
        let explains = self.backlog.end_turn(cx.now);
        self.shift(before, cx);
        explains
    }

    /// Records a missed reply.
    pub(super) fn suspect_backlog(&mut self, now: Instant) {
        self.backlog.suspect(now);
    }

    /// Returns whether it should move, but its answers are too late for that.
    pub(super) const fn is_too_late(&self) -> bool {
        self.mode.is_moving() && self.backlog.is_unusable()
    }

    /// Returns the time at which a state was current that arrived at `at`, and its latency.
    #[cold]
    pub(super) fn backdated(&self, at: Instant, latency: Duration, cx: &Context) -> (Instant, Duration) {
        let late = self.backlog.turns() * self.turn.time(cx.period);
        (at - late, latency + late)
    }

    /// Increases the age of the last state by the growth of the lateness since `before`, in turns.
    /// After a decrease, the last state keeps its published age.
    fn shift(&mut self, before: u32, cx: &mut Context) {
        let turns = self.backlog.turns();
        if turns == before {
            return;
        }
        let time = self.turn.time(cx.period);
        self.measured_at = self.measured_at - turns.saturating_sub(before) * time;
        self.replies.set_behind(turns);
        cx.push(Event::Late { motor: self.joint, turns, time: turns * time });
    }

    /// Forgets its backlog, after it was left alone.
    pub(super) fn forget_backlog(&mut self) {
        self.backlog = Backlog::default();
        self.replies.set_behind(0);
    }
}
