//! The cycles in which a motor gets its commands.
//!
//! On most buses every cycle is the turn of every motor, and a reply that has not arrived by the
//! end of the cycle is missed. Where motors take turns, a reply may arrive until the motor's next
//! turn.

use core::num::NonZero;
use motord_bus::{Duration, Instant};

/// The turns of one motor.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Turn {
    /// Cycles from one turn to the next.
    every: NonZero<u32>,
    /// Cycles until the next turn.
    left: u32,
    /// A turn ends when the next begins.
    pub(crate) outlasts_cycle: bool,
    /// This cycle is not the motor's turn.
    pub(super) waits: bool,
    /// When the last turn began.
    begun: Instant,
    /// Time since the turn before, at most two turns, s; `None` where every cycle is a turn.
    pub(super) elapsed: Option<f32>,
}

/// The commands that a motor gets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Access {
    /// One in each turn: its bus is served.
    Free,
    /// None: its bus is held.
    Held,
    /// One, in its next turn: its bus is held.
    Granted,
}

impl Access {
    /// Grants a command to a held motor that answered the last one without its state: a frame that
    /// is answered does not wait.
    pub(super) const fn hurry(&mut self) {
        if matches!(self, Self::Held) {
            *self = Self::Granted;
        }
    }
}

impl Turn {
    /// Every cycle.
    pub(crate) const EACH_CYCLE: Self = Self {
        every: NonZero::<u32>::MIN,
        left: 0,
        outlasts_cycle: false,
        waits: false,
        begun: Instant::ZERO,
        elapsed: None,
    };

    /// Once in `every` cycles, for the first time in the cycle after `cycle` others.
    pub(crate) const fn once_in(every: NonZero<u32>, cycle: u32) -> Self {
        Self { every, left: cycle, outlasts_cycle: true, waits: true, elapsed: Some(0.0), ..Self::EACH_CYCLE }
    }

    /// Returns the time from one turn to the next.
    pub(super) fn time(&self, period: Duration) -> Duration {
        self.every.get() * period
    }

    /// Begins a cycle at `now`. Returns whether it is the motor's turn. Missed ticks are not
    /// counted, so they take no turn from a motor.
    pub(crate) fn begin_cycle(&mut self, now: Instant, period: Duration) -> bool {
        self.waits = self.left > 0;
        if self.waits {
            self.left -= 1;
            return false;
        }
        self.left = self.every.get() - 1;
        self.elapsed = Some(now.since(self.begun).min(2 * self.every.get() * period).as_secs_f32());
        self.begun = now;
        true
    }
}
