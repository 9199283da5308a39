//! The clock of this machine: `CLOCK_MONOTONIC`, and the conversion of `CLOCK_REALTIME` to it.

use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, Timespec, clock_gettime};

use crate::time::{Duration, Instant};

/// Reads `CLOCK_MONOTONIC`. Neither allocates nor blocks; on most machines it is no system call
/// (vDSO).
#[must_use]
#[inline]
pub fn monotonic() -> Instant {
    Instant::from_nanos(read(ClockId::Monotonic))
}

/// Returns the present time, and the total time for which the computer was suspended since it was
/// started. `CLOCK_MONOTONIC` stops during suspension, and `CLOCK_BOOTTIME` continues. Never
/// overestimates: a delay between the two readings reduces the result. Neither allocates nor
/// blocks; on most machines it is no system call (vDSO).
#[must_use]
pub fn monotonic_and_suspended() -> (Instant, Duration) {
    let since_start = read(ClockId::Boottime);
    let now = monotonic();
    (now, Duration::from_nanos(since_start.saturating_sub(now.as_nanos())))
}

/// Sleeps until `instant`, or returns immediately when it has passed. A signal ends the sleep
/// early, so a caller that needs the instant reads the clock. Does not allocate; one system call.
pub fn sleep_until(instant: Instant) {
    let nanos = instant.as_nanos();
    let request = Timespec { tv_sec: (nanos / 1_000_000_000) as i64, tv_nsec: (nanos % 1_000_000_000) as _ };
    // With a valid time on this clock, the only possible error is EINTR, which is an early return.
    let _early = clock_nanosleep_absolute(ClockId::Monotonic, &request);
}

#[inline]
fn read(clock: ClockId) -> u64 {
    let time = clock_gettime(clock);
    (time.tv_sec as u64).wrapping_mul(1_000_000_000).wrapping_add(time.tv_nsec as u64)
}

/// The difference of `CLOCK_REALTIME` from `CLOCK_MONOTONIC`.
///
/// The kernel stamps received frames in `CLOCK_REALTIME` only. NTP slews both clocks alike, so
/// their difference is constant until a process sets the time. It is measured once a second, and
/// immediately when a stamp is impossible. Between two measurements the clock is read only for a
/// stamp from before the last request.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RealtimeOffset {
    /// Realtime minus monotonic, in ns.
    offset: i64,
    measured: Instant,
}

impl RealtimeOffset {
    const REMEASURE: Duration = Duration::from_secs(1);

    pub(crate) fn measure() -> Self {
        let sandwich = || {
            let before = read(ClockId::Monotonic);
            let realtime = read(ClockId::Realtime);
            let after = read(ClockId::Monotonic);
            let width = after.saturating_sub(before);
            // At the latest: a stamp may become later by the width of the reading, never earlier
            // than its frame.
            (width, realtime.wrapping_sub(after) as i64, after)
        };
        // A reading that was interrupted is wide. Three consecutive readings are not all
        // interrupted.
        let (_, offset, measured) = [sandwich(), sandwich(), sandwich()]
            .into_iter()
            .min_by_key(|&(width, ..)| width)
            .expect("three readings were taken");
        Self { offset, measured: Instant::from_nanos(measured) }
    }

    /// Returns the instant of a stamp that was taken between `earliest` and `now`, which has
    /// passed. The result always lies between them. A stamp from before `sent_at`, the last
    /// request, is late, or the time was set back by less than makes a stamp impossible. Neither
    /// allocates nor blocks; measures at most once per value of `now`.
    #[inline]
    pub(crate) fn monotonic(
        &mut self,
        stamp: RealtimeStamp,
        earliest: Instant,
        sent_at: Instant,
        now: Instant,
    ) -> Instant {
        // A stamp below the offset wraps around to an instant far beyond `now`.
        let at = Instant::from_nanos(stamp.0.wrapping_sub(self.offset.cast_unsigned()));
        if at >= earliest && at <= now && (at >= sent_at || !self.is_set_back(now)) {
            return at;
        }
        if self.measured < now {
            self.measure_again(now);
        }
        self.apply(stamp).max(earliest).min(now)
    }

    /// Measures again when the last measurement is a second old at `now`. Neither allocates nor
    /// blocks; reads the clocks.
    #[inline]
    pub(crate) fn refresh(&mut self, now: Instant) {
        if now >= self.measured + Self::REMEASURE {
            self.measure_again(now);
        }
    }

    /// Returns `true` when a reading after `now` is earlier than it.
    #[cold]
    fn is_set_back(&self, now: Instant) -> bool {
        self.apply(RealtimeStamp(read(ClockId::Realtime))) < now
    }

    #[cold]
    fn measure_again(&mut self, now: Instant) {
        *self = Self { measured: now.max(self.measured), ..Self::measure() };
    }

    fn apply(&self, stamp: RealtimeStamp) -> Instant {
        Instant::from_nanos(stamp.0.saturating_sub_signed(self.offset))
    }
}

/// A reading of `CLOCK_REALTIME`, in ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct RealtimeStamp(pub(crate) u64);

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: u64 = 3_600_000_000_000;

    fn stamp_now() -> RealtimeStamp {
        RealtimeStamp(read(ClockId::Realtime))
    }

    /// Otherwise a reply would be earlier than its request.
    #[test]
    fn stamp_becomes_its_instant_and_none_before() {
        for _ in 0..10_000 {
            let mut offset = RealtimeOffset::measure();
            let before = monotonic();
            let stamp = stamp_now();
            let after = monotonic();
            let at = offset.monotonic(stamp, Instant::ZERO, Instant::ZERO, after + Duration::from_millis(1));
            let tolerance = Duration::from_millis(20);
            assert!(at >= before && at <= after + tolerance, "{before:?} {at:?} {after:?}");
        }
    }

    #[test]
    fn clock_set_back_slightly_moves_no_stamp() {
        let mut offset = RealtimeOffset::measure();
        let earliest = monotonic() - Duration::from_secs(1);
        let (before, stamp) = (monotonic(), stamp_now());
        let now = monotonic();
        // As if the clock had been set back by half the time since the last frame.
        offset.offset += 500_000_000;
        let at = offset.monotonic(stamp, earliest, before, now);
        assert!(at >= before - Duration::from_millis(20), "{before:?} {at:?}");
    }

    #[test]
    fn setting_the_time_of_day_moves_no_stamp() {
        for step in [-(HOUR as i64), HOUR as i64] {
            let mut offset = RealtimeOffset::measure();
            offset.offset = offset.offset.saturating_add(step);
            let earliest = monotonic();
            let stamp = stamp_now();
            let now = monotonic() + Duration::from_millis(1);
            let at = offset.monotonic(stamp, earliest, earliest, now);
            assert!(at.since(earliest) < Duration::from_millis(20) && at <= now, "{step}: {at:?}");
        }
    }

    #[test]
    fn clock_difference_is_measured_again_each_second() {
        let mut offset = RealtimeOffset::measure();
        let right = offset.offset;
        let measured = offset.measured;
        offset.offset = right.saturating_add(HOUR as i64);
        offset.refresh(measured + RealtimeOffset::REMEASURE - Duration::from_nanos(1));
        assert_eq!(offset.offset, right.saturating_add(HOUR as i64));
        offset.refresh(measured + RealtimeOffset::REMEASURE);
        assert!(offset.offset.abs_diff(right) < 20_000_000, "{} and {right}", offset.offset);
    }

    #[test]
    fn no_stamp_is_later_than_now() {
        let mut offset = RealtimeOffset::measure();
        let (earliest, now) = (Instant::from_nanos(9), Instant::from_nanos(5));
        for stamp in [0, 1, u64::MAX] {
            assert_eq!(offset.monotonic(RealtimeStamp(stamp), earliest, earliest, now), now);
        }
    }

    #[test]
    fn a_computer_that_is_awake_counts_no_suspension() {
        let suspended = || monotonic_and_suspended().1;
        let before = suspended();
        for _ in 0..10_000 {
            assert!(suspended() < before + Duration::from_millis(100), "while the computer is not suspended");
        }
    }

    #[test]
    fn a_sleep_ends_after_its_instant() {
        let until = monotonic() + Duration::from_millis(2);
        sleep_until(until);
        assert!(monotonic() >= until);
        sleep_until(Instant::ZERO);
    }
}
