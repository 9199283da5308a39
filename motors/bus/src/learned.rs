//! Estimates from observations: the lateness of wake-ups, the time of replies, and the use of
//! polling.

use crate::time::{Duration, Instant, nanos};

/// Expected lateness of a thread's next wake-up, by which the thread shortens its sleep. The
/// estimate settles above the mean: of two equally large deviations, the later wake-up has four
/// times the weight. Neither allocates nor blocks.
#[derive(Debug, Clone, Copy, Default)]
pub struct Lateness {
    /// ns.
    expected: u64,
}

impl Lateness {
    /// A later wake-up changes the expectation by 1/`RISE` of the difference, an earlier one by
    /// 1/`FALL`.
    const RISE: u64 = 16;
    const FALL: u64 = 64;
    /// Upper limit of a wake-up's lateness, ns: a shorter sleep does not help against a stall.
    const MAX: u64 = 100_000;

    /// Records that the thread slept until `due`, and was awake at `now`.
    pub fn observe(&mut self, due: Instant, now: Instant) {
        let late = now.as_nanos().saturating_sub(due.as_nanos()).min(Self::MAX);
        let Self { expected } = *self;
        self.expected = match late > expected {
            true => expected + (late - expected) / Self::RISE,
            // Rounded up, so that the expectation reaches zero on a computer that is never late.
            false => expected - (expected - late).div_ceil(Self::FALL),
        };
    }

    /// Returns the expected lateness: zero before the first sleep, and never above 100 µs.
    #[must_use]
    pub const fn expected(self) -> Duration {
        Duration::from_nanos(self.expected)
    }
}

/// Time from sending frames to the last reply to them. Neither allocates nor blocks.
#[derive(Debug, Clone, Copy)]
pub struct ReplyTime {
    /// ns.
    latest: u64,
    /// ns.
    earliest: u64,
}

impl ReplyTime {
    /// A slow step takes 1/`SLOW` of the difference to the observed time, a fast step 1/`FAST`.
    const SLOW: u64 = 32;
    const FAST: u64 = 4;

    /// Returns an estimate for which `time` is both the latest and the earliest time until the
    /// first reply is observed.
    #[must_use]
    pub const fn new(time: Duration) -> Self {
        Self { latest: nanos(time), earliest: nanos(time) }
    }

    /// Records that the last reply took `time`.
    pub fn observe(&mut self, time: Duration) {
        let (Self { latest, earliest }, time) = (*self, nanos(time));
        self.latest = if time > latest { time } else { latest - (latest - time) / Self::SLOW };
        self.earliest = match time > earliest {
            true => earliest + (time - earliest) / Self::SLOW,
            false => earliest - (earliest - time) / Self::FAST,
        };
    }

    /// Returns the time by which the last reply has usually arrived. It follows a longer time fast,
    /// and a shorter one slowly.
    #[must_use]
    pub const fn latest(self) -> Duration {
        Duration::from_nanos(self.latest)
    }

    /// Returns the time before which the last reply rarely arrives. It follows a longer time
    /// slowly, and a shorter one fast.
    #[must_use]
    pub const fn earliest(self) -> Duration {
        Duration::from_nanos(self.earliest)
    }
}

/// Limits attempts that may fail, such as polling for the reply of a motor that is off. After two
/// consecutive failures the next attempt is skipped. Each further failure about doubles the number
/// of skipped attempts, up to 63. Neither allocates nor blocks.
#[derive(Debug, Clone, Copy, Default)]
pub struct Backoff {
    failures: u32,
    left_out: u32,
}

impl Backoff {
    /// Most failures that are counted.
    const FAILURES_MAX: u32 = 7;

    /// Returns `true` when the caller should make the next attempt.
    #[must_use]
    pub const fn attempts(&mut self) -> bool {
        let attempts = self.left_out == 0;
        self.left_out = self.left_out.saturating_sub(1);
        attempts
    }

    /// Records the result of an attempt.
    pub fn observe(&mut self, has_failed: bool) {
        self.failures = if has_failed { (self.failures + 1).min(Self::FAILURES_MAX) } else { 0 };
        self.left_out = (1 << self.failures.saturating_sub(1)) - 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn last_reply_falls_between_earliest_and_latest() {
        let mut reply = ReplyTime::new(Duration::from_micros(100));
        // Between 600 and 650 µs, uniformly distributed.
        let times = || (0..2000_u64).map(|index| Duration::from_micros(600 + index * 23 % 51));
        times().for_each(|time| reply.observe(time));
        let (mut early, mut late) = (0, 0);
        for time in times() {
            early += u32::from(time < reply.earliest());
            late += u32::from(time > reply.latest());
            reply.observe(time);
        }
        assert!(early < 600 && late < 600, "{early} too early, {late} too late of 2000");
        assert!(reply.latest() - reply.earliest() < Duration::from_micros(51), "{reply:?}");
        reply.observe(Duration::from_micros(900));
        assert_eq!(
            reply.latest(),
            Duration::from_micros(900),
            "a late reply is waited for in the next cycle"
        );
        assert!(reply.earliest() < Duration::from_micros(630), "and not missed because of one: {reply:?}");
    }

    #[test]
    fn fruitless_attempts_become_rare_until_success() {
        let mut backoff = Backoff::default();
        let mut attempts = |cycles: u32, has_failed: bool| {
            let attempt = |_: &u32| {
                let attempts = backoff.attempts();
                attempts.then(|| backoff.observe(has_failed)).is_some()
            };
            (0..cycles).filter(attempt).count()
        };
        assert_eq!(attempts(2, true), 2, "one may be by chance");
        attempts(200, true);
        assert_eq!(attempts(6400, true), 100);
        assert!(attempts(64, false) > 0);
        assert_eq!(attempts(64, false), 64, "a success ends it");
    }

    fn after(sleeps: impl Iterator<Item = u64>) -> Duration {
        let mut lateness = Lateness::default();
        sleeps.for_each(|late| lateness.observe(Instant::ZERO, Instant::from_nanos(1000 * late)));
        lateness.expected()
    }

    #[test]
    fn punctual_computer_is_not_thought_late_forever() {
        assert_eq!(after([50_000].into_iter().chain([0; 1000])), Duration::ZERO);
    }

    #[test]
    fn learned_time_covers_most_wakeups_and_forgets_stalls() {
        // Between 10 and 20 µs, uniformly distributed.
        let wake_ups = || (0..1000).map(|index| 10 + index * 7 % 11);
        let learned = after(wake_ups());
        assert!((Duration::from_micros(15)..Duration::from_micros(20)).contains(&learned), "{learned:?}");
        let stalled = after(wake_ups().chain([1_000_000]));
        assert!(stalled < learned + Duration::from_micros(6), "{stalled:?}");
        let always = after([u64::MAX / 1000; 10_000].into_iter());
        assert!((Duration::from_micros(99)..=Duration::from_micros(100)).contains(&always), "{always:?}");
    }
}
