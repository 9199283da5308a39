//! Which frames the motors of one bus get, and when: a pure function of the time and of the rounds that the bus took.
//!
//! ```text
//!                  rounds for all of `damp` taken              STOPS rounds taken
//!   begin ──▶ Damping ─────────────────────────────▶ Stopping ───────────────────▶ Served
//! ```
//!
//! A round is one frame to each motor. It counts when the bus took all of its frames. A bus that is jammed or missing is
//! owed its rounds until it takes them: its motors keep their last command meanwhile, and are damped before they are stopped
//! whenever it comes back. A queue holds two rounds of frames, so a third round that is taken proves that the first has
//! left.

use motord_bus::{Duration, Instant};

/// Between two frames to a motor: 100 Hz. A drive keeps its last command, so a higher rate would only fill the bus.
pub const INTERVAL: Duration = Duration::from_millis(10);
/// Between two tries on a bus that still refuses when the damping would be over: 10 Hz.
const RETRY: Duration = Duration::from_millis(100);
/// Stop frames to each motor, after damping.
const STOPS: u32 = 3;

/// The kind of frame that every motor gets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
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
    /// From here on a refused round is tried again after [`RETRY`].
    slow_from: Instant,
}

impl Schedule {
    /// A schedule that begins at `now` and damps for `damp`.
    #[must_use]
    pub fn begin(damp: Duration, now: Instant) -> Self {
        let rounds = damp.as_nanos().div_ceil(INTERVAL.as_nanos());
        let phase = match u32::try_from(rounds).unwrap_or(u32::MAX) {
            0 => Phase::Stopping { left: STOPS },
            left => Phase::Damping { left },
        };
        Self { phase, due: now, interval: INTERVAL, slow_from: now + damp }
    }

    /// When the next round is due; `None` when the bus is served.
    #[must_use]
    pub fn due(&self) -> Option<Instant> {
        (self.phase != Phase::Served).then_some(self.due)
    }

    /// Whether the bus still refused when the damping would have been over, and has taken nothing since.
    #[must_use]
    pub fn is_slow(&self) -> bool {
        self.interval == RETRY
    }

    /// The frames that are due at `now`, until the round is [recorded](Self::record).
    #[must_use]
    pub fn order(&self, now: Instant) -> Option<Order> {
        match self.phase {
            Phase::Damping { .. } if self.due <= now => Some(Order::Damp),
            Phase::Stopping { .. } if self.due <= now => Some(Order::Stop),
            Phase::Damping { .. } | Phase::Stopping { .. } | Phase::Served => None,
        }
    }

    /// Moves what is due to the next round after `now`, for a bus whose interface could not be looked for in this one.
    pub fn skip(&mut self, now: Instant) {
        self.due = next_tick(self.due, INTERVAL, now);
    }

    /// Records the round of `now`: whether the bus took all of its frames. Real-time: does not allocate, block or loop.
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

/// The first instant after `now` that is a whole number of `interval`s after `from`.
#[must_use]
pub fn next_tick(from: Instant, interval: Duration, now: Instant) -> Instant {
    let passed = now.since(from).as_nanos() / interval.as_nanos();
    from + interval.saturating_mul(u32::try_from(passed).unwrap_or(u32::MAX).saturating_add(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAMP: Duration = Duration::from_millis(100);
    const BEGIN: Instant = Instant::from_nanos(1_000_000_000);

    /// The rounds that the bus was given, in ms since the begin, when it takes those of which `takes` is true.
    fn given(millis: u64, takes: impl Fn(u64) -> bool) -> Vec<(u64, Order)> {
        let mut schedule = Schedule::begin(DAMP, BEGIN);
        let mut given = Vec::new();
        for at in 0..millis {
            let now = BEGIN + Duration::from_millis(at);
            let Some(order) = schedule.order(now) else { continue };
            given.push((at, order));
            schedule.record(takes(at), now);
        }
        given
    }

    /// Damping at 100 Hz from `begin` on, then the stops.
    fn whole_from(begin: u64) -> Vec<(u64, Order)> {
        let at = |round: u64| begin + 10 * round;
        (0..10)
            .map(|round| (at(round), Order::Damp))
            .chain((10..13).map(|round| (at(round), Order::Stop)))
            .collect()
    }

    #[test]
    fn a_bus_that_takes_everything_is_damped_for_as_long_as_asked_then_stopped_and_left_alone() {
        assert_eq!(given(1000, |_| true), whole_from(0));
    }

    #[test]
    fn a_bus_that_comes_back_late_gets_the_whole_of_it_at_the_full_rate() {
        let given = given(5000, |at| at >= 3000);
        let (refused, taken) = given.split_at(given.len() - 13);
        assert_eq!(taken, whole_from(3000));
        assert!(refused.iter().all(|(_, order)| *order == Order::Damp), "{refused:?}");
        assert_eq!(refused.len(), 10 + 29, "100 Hz for as long as the damping, then 10 Hz");
    }

    #[test]
    fn a_bus_that_is_jammed_with_two_rounds_in_its_queue_is_owed_the_rest() {
        let was_taken = |at| !(20..3000).contains(&at);
        let given = given(5000, was_taken);
        let (late, first): (Vec<_>, Vec<_>) =
            given.into_iter().filter(|(at, _)| was_taken(*at)).partition(|(at, _)| *at >= 3000);
        assert_eq!(first, [(0, Order::Damp), (10, Order::Damp)]);
        let late: Vec<_> = late.into_iter().map(|(_, order)| order).collect();
        assert_eq!(late, [[Order::Damp; 8].as_slice(), &[Order::Stop; 3]].concat());
    }

    #[test]
    fn a_bus_that_goes_away_while_it_is_stopped_gets_its_stops_later() {
        let given = given(5000, |at| at <= 100 || at >= 3000);
        let later: Vec<_> = given.iter().filter(|(at, _)| *at >= 3000).map(|(_, order)| *order).collect();
        assert_eq!(later, [Order::Stop; 2]);
    }

    #[test]
    fn a_bus_that_never_takes_anything_is_tried_for_ever() {
        let given = given(100_000, |_| false);
        assert_eq!(given.last(), Some(&(99_900, Order::Damp)));
    }

    #[test]
    fn a_schedule_that_was_stalled_sends_no_burst() {
        let mut schedule = Schedule::begin(DAMP, BEGIN);
        schedule.record(true, BEGIN);
        let late = BEGIN + Duration::from_millis(35);
        assert_eq!(schedule.order(late), Some(Order::Damp));
        schedule.record(true, late);
        assert_eq!(schedule.due(), Some(BEGIN + Duration::from_millis(40)), "the rounds keep their ticks");
    }

    #[test]
    fn without_a_damping_time_there_are_only_stops() {
        let mut schedule = Schedule::begin(Duration::ZERO, BEGIN);
        assert_eq!(schedule.order(BEGIN), Some(Order::Stop));
        schedule.record(false, BEGIN);
        assert_eq!(schedule.order(BEGIN + RETRY), Some(Order::Stop));
    }
}
