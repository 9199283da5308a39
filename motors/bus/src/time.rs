//! Time as a value. This module reads no clock; `clock` does, with the feature `linux`.

use core::fmt;
use core::ops::{Add, Sub};

pub use core::time::Duration;

const NANOS_PER_SECOND: u64 = 1_000_000_000;

/// A reading of `CLOCK_MONOTONIC`, in nanoseconds. Arithmetic saturates: a clock that runs
/// backwards because of a bug or an injected fault yields a zero duration, never a panic.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Instant(u64);

impl Instant {
    /// The start of the clock.
    pub const ZERO: Self = Self(0);
    /// Later than every instant that can be read.
    pub const FAR_FUTURE: Self = Self(u64::MAX);

    /// Returns the instant of these nanoseconds of `CLOCK_MONOTONIC`.
    #[must_use]
    pub const fn from_nanos(nanos: u64) -> Self {
        Self(nanos)
    }

    /// Returns nanoseconds of `CLOCK_MONOTONIC`.
    #[must_use]
    pub const fn as_nanos(self) -> u64 {
        self.0
    }

    /// Returns the time from `earlier` to `self`; zero when `earlier` is later.
    #[must_use]
    #[inline]
    pub const fn since(self, earlier: Self) -> Duration {
        match self.0.saturating_sub(earlier.0) {
            // Avoids the division that a longer time needs.
            nanos @ ..NANOS_PER_SECOND => Duration::new(0, nanos as u32),
            nanos => Duration::from_nanos(nanos),
        }
    }

    /// Returns the time from `earlier` to `self`, s; zero when `earlier` is later.
    #[must_use]
    #[inline]
    pub const fn seconds_since(self, earlier: Self) -> f32 {
        self.0.saturating_sub(earlier.0) as f32 * 1e-9
    }
}

/// Returns a duration's nanoseconds, saturated to 584 years.
#[must_use]
#[inline]
pub const fn nanos(duration: Duration) -> u64 {
    match duration.as_secs() {
        0 => duration.subsec_nanos() as u64,
        seconds => seconds.saturating_mul(NANOS_PER_SECOND).saturating_add(duration.subsec_nanos() as u64),
    }
}

impl Add<Duration> for Instant {
    type Output = Self;
    fn add(self, duration: Duration) -> Self {
        Self(self.0.saturating_add(nanos(duration)))
    }
}

impl Sub<Duration> for Instant {
    type Output = Self;
    fn sub(self, duration: Duration) -> Self {
        Self(self.0.saturating_sub(nanos(duration)))
    }
}

impl fmt::Debug for Instant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{:09}s", self.0 / 1_000_000_000, self.0 % 1_000_000_000)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backward_clock_gives_zero_duration() {
        assert_eq!(Instant::from_nanos(5).since(Instant::from_nanos(9)), Duration::ZERO);
        assert_eq!(Instant::from_nanos(5) - Duration::from_secs(1), Instant::ZERO);
        assert_eq!(Instant::FAR_FUTURE + Duration::MAX, Instant::FAR_FUTURE);
    }
}
