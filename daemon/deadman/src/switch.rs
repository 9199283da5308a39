//! When to act: a pure function of the heartbeat, the connection and the time.
//!
//! ```text
//!                 the heartbeat moves
//!        ┌───────────────────────────────────┐
//!        │    at rest                        ▼     stalls for `heartbeat_timeout`, or the connection is closed
//!      Quiet ◀────────────────────────── Watching ──────────────────────────────▶ Acting
//!        ▲                                   ▲                                       │
//!        │                                   └────────── the heartbeat moves ────────┤
//!        └──────────────────────────────────── at rest, or every bus is served ──────┘
//! ```
//!
//! When the heartbeat changes again, the switch leaves the motors to the daemon: that daemon was
//! late, detects it, and stops safely by itself. Two senders with different commands would be worse
//! than either. A closed connection is final: its daemon is dead.

use crate::heartbeat::AT_REST;
use motord_bus::{Duration, Instant};
use motord_core::stopper::schedule::{INTERVAL, next_tick};

/// Reads of the heartbeat within `heartbeat_timeout`. The switch detects the last beat, and its
/// absence, at most a fifth of `heartbeat_timeout` late.
const READS: u32 = 5;
/// The least time between two reads.
const READ_INTERVAL_MIN: Duration = Duration::from_millis(1);

/// Why the switch acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Cause {
    /// The connection closed, and the heartbeat was not at rest.
    #[error("the daemon died")]
    Died,
    /// The heartbeat did not change.
    #[error("the daemon's cycle stalled")]
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
    heartbeat_timeout: Duration,
    phase: Phase,
    heartbeat: u64,
    moved: Instant,
    /// The next read.
    due: Instant,
}

impl Switch {
    /// Creates a switch for a heartbeat, which is `heartbeat` at `now`. It acts when the heartbeat
    /// does not change for `heartbeat_timeout`.
    #[must_use]
    pub fn new(heartbeat_timeout: Duration, heartbeat: u64, now: Instant) -> Self {
        let phase = if heartbeat == AT_REST { Phase::Quiet } else { Phase::Watching };
        Self { heartbeat_timeout, phase, heartbeat, moved: now, due: now }
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

    /// Returns when the next [`step`](Self::step) is due, unless the switch acts: then one precedes
    /// every round.
    #[must_use]
    pub const fn due(&self) -> Instant {
        self.due
    }

    /// Checks the daemon at `now` by its heartbeat and by whether its connection is open.
    /// Real-time: does not allocate, block or loop.
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
        } else if self.phase == Phase::Watching && now.since(self.moved) >= self.heartbeat_timeout {
            self.phase = Phase::Acting(Cause::StoodStill);
        }
        if now >= self.due {
            let interval = (self.heartbeat_timeout / READS).clamp(READ_INTERVAL_MIN, INTERVAL);
            self.due = next_tick(self.due, interval, now);
        }
    }

    /// Ends the action: every bus is served.
    pub fn served(&mut self) {
        self.phase = Phase::Quiet;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEARTBEAT_TIMEOUT: Duration = Duration::from_millis(5);

    /// A switch and its world.
    struct Story {
        switch: Switch,
        now: Instant,
        connected: bool,
        /// Moves by itself every millisecond while this is set.
        beats: bool,
        heartbeat: u64,
    }

    impl Story {
        /// A daemon that has lived for a while.
        fn begin() -> Self {
            let now = Instant::from_nanos(1_000_000_000);
            let mut story = Self {
                switch: Switch::new(HEARTBEAT_TIMEOUT, 1, now),
                now,
                connected: true,
                beats: true,
                heartbeat: 1,
            };
            assert_eq!(story.pass(1000), None, "a living daemon is left alone");
            story
        }

        /// After how many ms the switch began to act, and why.
        fn pass(&mut self, millis: u64) -> Option<(u64, Cause)> {
            let mut began = None;
            for at in 0..millis {
                self.heartbeat += u64::from(self.beats);
                let acted = self.switch.acts();
                self.switch.step(self.now, self.connected, self.heartbeat);
                if acted.is_none() {
                    began = began.or(self.switch.acts().map(|cause| (at, cause)));
                }
                self.now = self.now + Duration::from_millis(1);
            }
            began
        }

        fn dies(&mut self) {
            (self.connected, self.beats) = (false, false);
        }
    }

    #[test]
    fn dead_daemon_is_acted_on_until_buses_served() {
        let mut story = Story::begin();
        story.dies();
        assert_eq!(story.pass(1000), Some((0, Cause::Died)));
        assert_eq!(story.switch.acts(), Some(Cause::Died), "however long that takes");
        story.switch.served();
        assert_eq!(story.pass(1000), None, "motors are stopped once");
    }

    #[test]
    fn stalled_heartbeat_is_noticed_within_fifth_of_timeout() {
        let mut story = Story::begin();
        story.beats = false;
        // The last beat was a millisecond before.
        assert_eq!(story.pass(1000), Some((4, Cause::StoodStill)));
        story.switch.served();
        story.dies();
        assert_eq!(story.pass(1000), None, "motors are stopped once");
    }

    #[test]
    fn heartbeat_is_checked_five_times_per_timeout() {
        let mut story = Story::begin();
        let first = story.switch.due();
        story.pass(1);
        assert_eq!(story.switch.due().since(first), HEARTBEAT_TIMEOUT / 5);
    }

    #[test]
    fn resumed_daemon_gets_its_motors_back() {
        let mut story = Story::begin();
        story.beats = false;
        assert!(story.pass(30).is_some());
        story.beats = true;
        story.pass(1);
        assert_eq!(story.switch.acts(), None);
        story.beats = false;
        assert_eq!(story.pass(1000), Some((4, Cause::StoodStill)), "and is watched as before");
    }

    #[test]
    fn daemon_that_left_stopped_robot_is_ignored() {
        for millis_until_it_closes in [0, 500] {
            let mut story = Story::begin();
            (story.beats, story.heartbeat) = (false, AT_REST);
            assert_eq!(story.pass(millis_until_it_closes), None);
            story.dies();
            assert_eq!(story.pass(1000), None);
        }
    }

    #[test]
    fn daemon_that_beats_once_and_dies_is_handled() {
        let mut story = Story::begin();
        story.beats = false;
        story.pass(1000);
        story.switch.served();
        story.heartbeat += 1;
        story.dies();
        assert_eq!(story.pass(1000), Some((0, Cause::Died)), "even after its motors were stopped");
        let mut story = Story::begin();
        story.heartbeat += 1;
        story.dies();
        assert_eq!(story.pass(1000), Some((0, Cause::Died)));
    }
}
