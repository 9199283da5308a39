//! The wall clock.

use std::time::{Duration, Instant, SystemTime};

/// Returns ns since 1970.
pub(crate) fn wall_ns() -> u64 {
    ns(SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default())
}

fn ns(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

/// The largest step back that is ignored, ns. The DDS library returns no best-effort message for as
/// long as the step.
const IGNORED_NS: u64 = 50_000_000;

/// Notices that the wall clock is set back.
pub(crate) struct ClockCheck {
    origin: Instant,
    /// The smallest wall time that the clock of the last check can have had at `origin`, ns.
    least_ns: u64,
}

impl ClockCheck {
    pub(crate) fn new() -> Self {
        let origin = Instant::now();
        Self { origin, least_ns: wall_ns().saturating_sub(ns(origin.elapsed())) }
    }

    /// Returns the step by which the clock was set back since the last check, if it is longer than
    /// [`IGNORED_NS`]. A pause of the thread is no step.
    pub(crate) fn step_back(&mut self) -> Option<Duration> {
        let before = ns(self.origin.elapsed());
        let wall = wall_ns();
        let after = ns(self.origin.elapsed());
        self.compare(before, wall, after)
    }

    /// Compares the wall clock, read between `before` and `after`, ns from `origin`.
    fn compare(&mut self, before: u64, wall: u64, after: u64) -> Option<Duration> {
        let step = self.least_ns.saturating_sub(wall.saturating_sub(before));
        self.least_ns = wall.saturating_sub(after);
        (step > IGNORED_NS).then(|| Duration::from_nanos(step))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn check() -> ClockCheck {
        ClockCheck { origin: Instant::now(), least_ns: 1_000_000 * MS }
    }

    #[test]
    fn clock_that_is_set_back_is_noticed_once() {
        let mut check = check();
        assert_eq!(check.compare(500 * MS, 1_000_440 * MS, 500 * MS), Some(Duration::from_millis(60)));
        assert_eq!(check.compare(1000 * MS, 1_000_940 * MS, 1000 * MS), None);
        assert_eq!(check.compare(1500 * MS, 0, 1500 * MS), Some(Duration::from_millis(999_940)));
    }

    #[test]
    fn pause_and_step_ahead_are_no_step_back() {
        let mut check = check();
        // The thread pauses for a second before the clock is read, and after it.
        assert_eq!(check.compare(500 * MS, 1_001_500 * MS, 1500 * MS), None);
        assert_eq!(check.compare(2000 * MS, 1_002_000 * MS, 3000 * MS), None);
        assert_eq!(check.compare(3500 * MS, 5_003_500 * MS, 3500 * MS), None);
        assert_eq!(check.compare(4000 * MS, 5_003_960 * MS, 4000 * MS), None);
    }
}
