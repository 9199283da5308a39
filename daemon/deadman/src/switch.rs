//! When to act: a pure function of the heartbeat, the connection and the time.
//!
//! ```text
//!                 the heartbeat moves
//!        ┌───────────────────────────────────┐
//!        │    at rest                        ▼     stands still for `patience`, or the connection is closed
//!      Quiet ◀────────────────────────── Watching ──────────────────────────────▶ Acting
//!        ▲                                   ▲                                       │
//!        │                                   └────────── the heartbeat moves ────────┤
//!        └──────────────────────────────────── at rest, or every bus is served ──────┘
//! ```
//!
//! A heartbeat that moves again takes the motors back: that daemon was late, knows it, and stops safely by itself. Two
//! senders that contradict each other would be worse than either. A closed connection is final: its daemon is dead.

use crate::heartbeat::AT_REST;
use motord_bus::{Duration, Instant};
use motord_core::stopper::schedule::{INTERVAL, next_tick};

/// Reads of the heartbeat within `patience`. The last beat is seen at most a fifth of `patience` late, and so is its
/// absence.
const READS: u32 = 5;
/// The least time between two reads.
const READ_INTERVAL_MIN: Duration = Duration::from_millis(1);

/// Why the switch acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Cause {
    /// The connection closed, and the heartbeat was not at rest.
    #[error("the daemon died")]
    Died,
    /// The heartbeat stood still.
    #[error("the daemon's cycle stood still")]
    StoodStill,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Quiet,
    Watching,
    Acting(Cause),
}

/// A dead man's switch for one daemon.
#[derive(Debug)]
pub struct Switch {
    patience: Duration,
    phase: Phase,
    heartbeat: u64,
    moved: Instant,
    /// The next read.
    due: Instant,
}

impl Switch {
    /// A switch for a heartbeat, which is `heartbeat` at `now`. It acts when the heartbeat stands still for `patience`.
    #[must_use]
    pub fn new(patience: Duration, heartbeat: u64, now: Instant) -> Self {
        let phase = if heartbeat == AT_REST { Phase::Quiet } else { Phase::Watching };
        Self { patience, phase, heartbeat, moved: now, due: now }
    }

    /// The cause, while the switch acts.
    #[must_use]
    pub const fn acts(&self) -> Option<Cause> {
        match self.phase {
            Phase::Acting(cause) => Some(cause),
            Phase::Quiet | Phase::Watching => None,
        }
    }

    /// The heartbeat at the last step.
    #[must_use]
    pub const fn heartbeat(&self) -> u64 {
        self.heartbeat
    }

    /// When the next [`step`](Self::step) is due, unless the switch acts: then there is one before every round.
    #[must_use]
    pub const fn due(&self) -> Instant {
        self.due
    }

    /// Judges the daemon at `now` by its heartbeat and by whether its connection is open. Real-time: does not allocate,
    /// block or loop.
    pub fn step(&mut self, now: Instant, connected: bool, heartbeat: u64) {
        let moved = heartbeat != self.heartbeat;
        self.heartbeat = heartbeat;
        if heartbeat == AT_REST {
            self.phase = Phase::Quiet;
        } else if connected && moved {
            self.phase = Phase::Watching;
            self.moved = now;
        } else if !connected && (moved || self.phase == Phase::Watching) && self.acts().is_none() {
            self.phase = Phase::Acting(Cause::Died);
        } else if self.phase == Phase::Watching && now.since(self.moved) >= self.patience {
            self.phase = Phase::Acting(Cause::StoodStill);
        }
        if now >= self.due {
            let interval = (self.patience / READS).clamp(READ_INTERVAL_MIN, INTERVAL);
            self.due = next_tick(self.due, interval, now);
        }
    }

    /// Ends the action: every bus is served.
    pub fn served(&mut self) {
        self.phase = Phase::Quiet;
    }
}

#[cfg(test)]
#[path = "../tests/unit/switch.rs"]
mod tests;
