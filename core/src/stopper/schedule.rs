//! The frames that the motors of one bus get, and their times: a pure function of time and of
//! accepted rounds.
//!
//! ```text
//!                  rounds for all of `damp` taken              STOPS rounds taken
//!   begin ──▶ Damping ─────────────────────────────▶ Stopping ───────────────────▶ Served
//! ```
//!
//! A round is one frame to each motor. It counts when the bus accepts all of its frames. The rounds
//! of a jammed or missing bus stay due until it accepts them: its motors keep their last command,
//! and are damped before they are stopped when the bus reconnects. A queue holds two rounds of
//! frames, so a third accepted round proves that the first was sent.

use motord_bus::{Duration, Instant};

/// Interval between two frames to a motor: 100 Hz. A drive keeps its last command, so a higher rate
/// has no effect.
pub const INTERVAL: Duration = Duration::from_millis(10);
/// Interval between two attempts on a bus that refuses after the regular end of the damping: 10 Hz.
const RETRY: Duration = Duration::from_millis(100);
/// Stop frames to each motor, after damping.
const STOPS: u32 = 3;

/// The kind of frame that every motor gets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SafeFrame {
    /// The frame that damps it.
    Damp,
    /// The frame that stops it.
    Stop,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Damping { left: u32 },
    Stopping { left: u32 },
    Served,
}

/// The rounds of one bus.
#[derive(Debug, Clone, Copy)]
pub struct Schedule {
    phase: Phase,
    due: Instant,
    /// From the last round to the one that is due.
    interval: Duration,
    /// From this time on a refused round is repeated after [`RETRY`].
    slow_from: Instant,
}

impl Schedule {
    /// Creates a schedule that begins at `now` and damps for `damp`.
    #[must_use]
    pub fn begin(damp: Duration, now: Instant) -> Self {
        let rounds = damp.as_nanos().div_ceil(INTERVAL.as_nanos());
        let phase = match u32::try_from(rounds).unwrap_or(u32::MAX) {
            0 => Phase::Stopping { left: STOPS },
            left => Phase::Damping { left },
        };
        Self { phase, due: now, interval: INTERVAL, slow_from: now + damp }
    }

    /// Returns when the next round is due; `None` when the bus is served.
    #[must_use]
    pub fn due(&self) -> Option<Instant> {
        (self.phase != Phase::Served).then_some(self.due)
    }

    /// Returns whether the bus refused its last round, after the regular end of the damping.
    #[must_use]
    pub fn is_slow(&self) -> bool {
        self.interval == RETRY
    }

    /// Returns the frames that are due at `now`, until the round is [recorded](Self::record).
    #[must_use]
    pub fn order(&self, now: Instant) -> Option<SafeFrame> {
        match self.phase {
            Phase::Damping { .. } if self.due <= now => Some(SafeFrame::Damp),
            Phase::Stopping { .. } if self.due <= now => Some(SafeFrame::Stop),
            Phase::Damping { .. } | Phase::Stopping { .. } | Phase::Served => None,
        }
    }

    /// Returns which of the two frames that damp a motor is due: accepted rounds take turns.
    #[must_use]
    pub fn turn(&self) -> usize {
        match self.phase {
            Phase::Damping { left } => left as usize % 2,
            Phase::Stopping { .. } | Phase::Served => 0,
        }
    }

    /// Delays the due round to the next interval after `now`, for a bus whose interface was not
    /// searched in this one.
    pub fn skip(&mut self, now: Instant) {
        self.due = next_tick(self.due, INTERVAL, now);
    }

    /// Records whether the bus accepted all frames of the round of `now`. Real-time: does not
    /// allocate, block or loop.
    pub fn record(&mut self, taken: bool, now: Instant) {
        if taken {
            self.phase = match self.phase {
                Phase::Damping { left: 1 } => Phase::Stopping { left: STOPS },
                Phase::Damping { left } => Phase::Damping { left: left - 1 },
                Phase::Stopping { left } if left > 1 => Phase::Stopping { left: left - 1 },
                Phase::Stopping { .. } | Phase::Served => Phase::Served,
            };
        }
        self.interval = if taken || now < self.slow_from { INTERVAL } else { RETRY };
        self.due = next_tick(self.due, self.interval, now);
    }
}

/// Returns the first instant after `now` that is a whole number of `interval`s after `from`.
#[must_use]
pub fn next_tick(from: Instant, interval: Duration, now: Instant) -> Instant {
    let passed = now.since(from).as_nanos() / interval.as_nanos();
    from + interval.saturating_mul(u32::try_from(passed).unwrap_or(u32::MAX).saturating_add(1))
}
