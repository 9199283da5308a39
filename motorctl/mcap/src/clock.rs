//! The times of a file, and steps of the computer's clock.

use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// Smallest change of the clock that is a step, ns. Corrections of NTP without a step change it by
/// at most 0.5 ms a second.
const STEP_NS: u64 = 50_000_000;
/// Between two checks of the clock, ns.
const CHECK_NS: u64 = 100_000_000;
/// Longest time between the readings of the two clocks, ns. Otherwise they are read again.
const READ_NS: u128 = 1_000_000;
/// Attempts to read both clocks within [`READ_NS`].
const TRIES: usize = 3;

/// Unix time at the zero of `CLOCK_MONOTONIC`. It is constant for a file: setting the clock
/// meanwhile does not distort curves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Origin {
    /// Unix time at the zero of `CLOCK_MONOTONIC`, ns.
    pub unix_ns: u64,
}

impl Origin {
    /// Returns the Unix time, ns, where `CLOCK_MONOTONIC` shows `time_ns`.
    #[must_use]
    pub fn unix(self, time_ns: u64) -> u64 {
        self.unix_ns.saturating_add(time_ns)
    }
}

/// Both clocks at one time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reading {
    /// `CLOCK_MONOTONIC`, ns.
    pub monotonic_ns: u64,
    /// Unix time, ns; 0 before 1970.
    pub unix_ns: u64,
}

impl Reading {
    fn origin(self) -> Origin {
        Origin { unix_ns: self.unix_ns.saturating_sub(self.monotonic_ns) }
    }
}

/// A step of Unix time against `CLOCK_MONOTONIC`: a person or NTP set the clock, or the computer
/// was suspended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClockStep {
    /// When it was noticed, ns of `CLOCK_MONOTONIC`: at most 0.1 s later, if the clock is watched.
    pub at_ns: u64,
    /// Its size, ns; negative where the clock was set back.
    pub by_ns: i64,
}

impl ClockStep {
    /// Returns the text of the event in a recording.
    #[cfg(feature = "files")]
    pub(crate) fn text(self) -> String {
        let (direction, seconds) =
            (if self.by_ns < 0 { "back" } else { "forward" }, self.by_ns.unsigned_abs() as f64 / 1e9);
        format!(
            "the computer's clock was set {direction} by {seconds:.3} s, or it slept; the times of this file do not follow"
        )
    }
}

/// The clocks of the computer, and the last known distance between them.
pub struct Clock {
    read: Box<dyn FnMut() -> Reading + Send>,
    known: Origin,
    due_ns: u64,
}

impl Clock {
    /// Returns the clocks of this computer, where `CLOCK_MONOTONIC` shows `now_ns`.
    #[must_use]
    pub fn system(now_ns: u64) -> Self {
        let begun = Instant::now();
        Self::of(move || {
            let read = || {
                let before = Instant::now();
                let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
                (before, unix, before.elapsed().as_nanos() <= READ_NS)
            };
            let first_or_close = (1..TRIES).map(|_| read()).find(|(_, _, is_close)| *is_close);
            let (before, unix, _) = first_or_close.unwrap_or_else(read);
            let since = u64::try_from(before.duration_since(begun).as_nanos()).unwrap_or(u64::MAX);
            Reading {
                monotonic_ns: now_ns.saturating_add(since),
                unix_ns: u64::try_from(unix.as_nanos()).unwrap_or(u64::MAX),
            }
        })
    }

    /// Returns clocks that `read` reads.
    #[must_use]
    pub fn of(read: impl FnMut() -> Reading + Send + 'static) -> Self {
        let mut clock = Self { read: Box::new(read), known: Origin::default(), due_ns: 0 };
        clock.known = clock.origin();
        clock
    }

    /// Returns the origin of times by the clock as it is set now.
    pub fn origin(&mut self) -> Origin {
        (self.read)().origin()
    }

    /// Returns the step of the clock since the last call that checked it. Checks at most ten times
    /// a second; corrections that are smaller than 50 ms in that time are no step.
    pub fn step(&mut self) -> Option<ClockStep> {
        let reading = (self.read)();
        if reading.monotonic_ns < self.due_ns {
            return None;
        }
        self.due_ns = reading.monotonic_ns.saturating_add(CHECK_NS);
        let (before, is) = (std::mem::replace(&mut self.known, reading.origin()), reading.origin());
        if is.unix_ns.abs_diff(before.unix_ns) < STEP_NS {
            return None;
        }
        let by = i128::from(is.unix_ns) - i128::from(before.unix_ns);
        let by_ns = i64::try_from(by).unwrap_or(if by < 0 { i64::MIN } else { i64::MAX });
        Some(ClockStep { at_ns: reading.monotonic_ns, by_ns })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    /// Returns the steps of a clock whose origin is `unix` at each second.
    fn steps(unix: &'static [u64]) -> Vec<(u64, i64)> {
        let mut at = 0..;
        let mut clock = Clock::of(move || {
            let second = at.next().unwrap_or(0);
            let monotonic_ns = second as u64 * SECOND;
            Reading { monotonic_ns, unix_ns: unix[second.min(unix.len() - 1)] + monotonic_ns }
        });
        (1..unix.len()).filter_map(|_| clock.step()).map(|step| (step.at_ns / SECOND, step.by_ns)).collect()
    }

    #[test]
    fn step_is_noticed_once_and_slew_never() {
        assert_eq!(steps(&[0, 0, 0]), []);
        assert_eq!(steps(&[0, 500_000, 1_000_000, 1_500_000]), [], "as NTP corrects");
        assert_eq!(steps(&[0, 0, 1_767_225_600 * SECOND, 1_767_225_600 * SECOND]).len(), 1);
        assert_eq!(
            steps(&[5 * SECOND, 5 * SECOND, 2 * SECOND, 5 * SECOND]),
            [(2, -3_000_000_000), (3, 3_000_000_000)]
        );
        assert_eq!(steps(&[0, u64::MAX / 2, 0]).len(), 2, "absurd clocks do no harm");
    }

    #[test]
    fn clock_of_this_computer_steps_by_nothing() {
        let mut clock = Clock::system(7 * SECOND);
        assert!(clock.origin().unix_ns > 0);
        assert_eq!((0..100).find_map(|_| clock.step()), None);
    }
}
