//! When to act, and what to send when: a pure function of the heartbeat, the connection and the time.
//!
//! ```text
//!                 the heartbeat moves
//!        ┌───────────────────────────────────┐
//!        │    at rest                        ▼     stands still for `patience`, or the connection is closed
//!      Quiet ◀────────────────────────── Watching ──────────────────────────────▶ Damping
//!        ▲                                   ▲                                       │ `damp` is over
//!        │                                   └──── the heartbeat moves ────┬─────────┤
//!        │                                                                 │         ▼
//!        └───────────────────────────────────────────────── STOPS sent ────┴────  Stopping
//! ```
//!
//! A heartbeat that moves again takes the motors back: that daemon was late, knows it, and stops safely by itself. Two
//! senders with different opinions would be worse than either. A closed connection is final: its heartbeat is dead.

use crate::heartbeat::AT_REST;
use motord_bus::{Duration, Instant};

/// Between two frames to a motor: 100 Hz. A drive keeps its last command, so more would only fill the bus.
pub const INTERVAL: Duration = Duration::from_millis(10);
/// Stop frames to each motor, after damping.
pub const STOPS: u8 = 3;
/// The heartbeat is looked at this often within `patience`: its last beat is seen a fifth later at most, and that it stands
/// still another fifth.
const LOOKS: u32 = 5;
/// It is not looked at more often than this.
const LOOK_LEAST: Duration = Duration::from_millis(1);

/// What to send to every motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// The frame that damps it.
    Damp,
    /// The frame that stops it.
    Stop,
}

/// Why the switch acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Cause {
    /// The connection closed, and the heartbeat was not at rest.
    #[error("the daemon died")]
    Died,
    /// The heartbeat stood still.
    #[error("the daemon's cycle stood still")]
    StoodStill,
    /// Somebody wants it.
    #[error("asked to")]
    Asked,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Quiet,
    Watching,
    Damping { cause: Cause, until: Instant },
    Stopping { cause: Cause, left: u8 },
}

/// A dead man's switch for one daemon.
#[derive(Debug)]
pub struct Switch {
    patience: Duration,
    damp: Duration,
    phase: Phase,
    heartbeat: u64,
    moved: Instant,
    /// The next look, or the next order.
    due: Instant,
}

impl Switch {
    /// Watches a heartbeat, which is `heartbeat` at `now`. It acts when that stands still for `patience`, and damps for
    /// `damp`.
    #[must_use]
    pub fn new(patience: Duration, damp: Duration, heartbeat: u64, now: Instant) -> Self {
        let phase = if heartbeat == AT_REST { Phase::Quiet } else { Phase::Watching };
        Self { patience, damp, phase, heartbeat, moved: now, due: now }
    }

    /// Acts from `now` on, with nobody to watch.
    #[must_use]
    pub fn asked(damp: Duration, now: Instant) -> Self {
        let phase = Phase::Damping { cause: Cause::Asked, until: now + damp };
        Self { phase, ..Self::new(Duration::MAX, damp, AT_REST + 1, now) }
    }

    /// Why it acts, while it does.
    #[must_use]
    pub const fn acts(&self) -> Option<Cause> {
        match self.phase {
            Phase::Damping { cause, .. } | Phase::Stopping { cause, .. } => Some(cause),
            Phase::Quiet | Phase::Watching => None,
        }
    }

    /// The heartbeat as it was told last.
    #[must_use]
    pub const fn heartbeat(&self) -> u64 {
        self.heartbeat
    }

    /// When [`step`](Self::step) is due next.
    #[must_use]
    pub const fn due(&self) -> Instant {
        self.due
    }

    /// What to send at `now`, given the daemon's heartbeat and whether its connection is open. Real-time: does not
    /// allocate, block or loop.
    pub fn step(&mut self, now: Instant, connected: bool, heartbeat: u64) -> Option<Order> {
        let moved = heartbeat != self.heartbeat;
        self.heartbeat = heartbeat;
        if heartbeat == AT_REST {
            self.phase = Phase::Quiet;
        } else if connected && moved {
            self.phase = Phase::Watching;
            self.moved = now;
        } else if !connected && (moved || self.phase == Phase::Watching) && self.acts().is_none() {
            self.begin(Cause::Died, now);
        } else if self.phase == Phase::Watching && now.since(self.moved) >= self.patience {
            self.begin(Cause::StoodStill, now);
        }
        if now < self.due {
            return None;
        }
        let order = self.order(now);
        self.due = later_on_the_grid(self.due, self.interval(), now);
        order
    }

    fn begin(&mut self, cause: Cause, now: Instant) {
        self.phase = Phase::Damping { cause, until: now + self.damp };
        self.due = now;
    }

    fn order(&mut self, now: Instant) -> Option<Order> {
        if let Phase::Damping { cause, until } = self.phase {
            if now < until {
                return Some(Order::Damp);
            }
            self.phase = Phase::Stopping { cause, left: STOPS };
        }
        let Phase::Stopping { cause, left } = self.phase else { return None };
        self.phase = match left - 1 {
            0 => Phase::Quiet,
            left => Phase::Stopping { cause, left },
        };
        Some(Order::Stop)
    }

    fn interval(&self) -> Duration {
        match self.phase {
            Phase::Damping { .. } | Phase::Stopping { .. } => INTERVAL,
            Phase::Quiet | Phase::Watching => (self.patience / LOOKS).clamp(LOOK_LEAST, INTERVAL),
        }
    }
}

/// The first instant after `now` that lies a whole number of `interval`s after `from`.
fn later_on_the_grid(from: Instant, interval: Duration, now: Instant) -> Instant {
    let passed = now.since(from).as_nanos() / interval.as_nanos();
    from + interval.saturating_mul(u32::try_from(passed).unwrap_or(u32::MAX).saturating_add(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATIENCE: Duration = Duration::from_millis(5);
    const DAMP: Duration = Duration::from_millis(100);

    /// A switch, its world, and what it sent when, in ms since the world changed last.
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
                switch: Switch::new(PATIENCE, DAMP, 1, now),
                now,
                connected: true,
                beats: true,
                heartbeat: 1,
            };
            assert_eq!(story.pass(1000), [], "a living daemon is left alone");
            story
        }

        fn pass(&mut self, millis: u64) -> Vec<(u64, Order)> {
            let mut sent = Vec::new();
            for at in 0..millis {
                self.heartbeat += u64::from(self.beats);
                let order = self.switch.step(self.now, self.connected, self.heartbeat);
                sent.extend(order.map(|order| (at, order)));
                self.now = self.now + Duration::from_millis(1);
            }
            sent
        }

        fn dies(&mut self) {
            (self.connected, self.beats) = (false, false);
        }
    }

    /// Damping at 100 Hz from `begin` on, then the stops.
    fn will_from(begin: u64) -> Vec<(u64, Order)> {
        let at = |turn: u64| begin + 10 * turn;
        (0..10)
            .map(|turn| (at(turn), Order::Damp))
            .chain((10..13).map(|turn| (at(turn), Order::Stop)))
            .collect()
    }

    #[test]
    fn a_daemon_that_dies_is_followed_by_damping_at_once_and_then_stops() {
        let mut story = Story::begin();
        story.dies();
        assert_eq!(story.pass(1000), will_from(0));
        assert_eq!(story.switch.acts(), None);
    }

    #[test]
    fn a_heartbeat_that_stands_still_is_followed_by_damping_within_a_fifth_of_the_patience() {
        let mut story = Story::begin();
        story.beats = false;
        let sent = story.pass(1000);
        assert_eq!(sent, will_from(4), "the last beat was a millisecond before");
        story.dies();
        assert_eq!(story.pass(1000), [], "a will is carried out once");
    }

    #[test]
    fn a_daemon_that_goes_on_gets_its_motors_back_before_the_next_frame() {
        let mut story = Story::begin();
        story.beats = false;
        assert_eq!(story.pass(30).len(), 3);
        story.beats = true;
        assert_eq!(story.pass(1000), []);
        story.beats = false;
        assert_eq!(story.pass(1000), will_from(4), "and is watched as before");
    }

    #[test]
    fn a_daemon_that_leaves_a_stopped_robot_is_not_followed_by_anything() {
        for millis_until_it_closes in [0, 500] {
            let mut story = Story::begin();
            (story.beats, story.heartbeat) = (false, AT_REST);
            assert_eq!(story.pass(millis_until_it_closes), []);
            story.dies();
            assert_eq!(story.pass(1000), []);
        }
    }

    #[test]
    fn a_daemon_that_beats_once_more_and_dies_is_followed_by_damping() {
        let mut story = Story::begin();
        story.beats = false;
        story.pass(1000);
        story.heartbeat += 1;
        story.dies();
        assert_eq!(story.pass(1000).len(), 13, "even after a will that was carried out");
        let mut story = Story::begin();
        story.heartbeat += 1;
        story.dies();
        assert_eq!(story.pass(1000), will_from(0));
    }

    #[test]
    fn a_switch_that_was_stalled_itself_sends_no_burst() {
        let mut story = Story::begin();
        story.dies();
        assert_eq!(story.pass(1).len(), 1);
        story.now = story.now + Duration::from_millis(35);
        assert_eq!(story.pass(1), [(0, Order::Damp)]);
        assert_eq!(story.pass(5).len(), 1, "the next is on the grid again");
    }

    #[test]
    fn whoever_asks_gets_the_whole_will() {
        let now = Instant::from_nanos(5);
        let mut story =
            Story { switch: Switch::asked(DAMP, now), now, connected: false, beats: false, heartbeat: 1 };
        assert_eq!(story.pass(1000), will_from(0));
    }
}
