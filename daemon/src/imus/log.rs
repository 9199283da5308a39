//! The lines of the log about one IMU.

use core::fmt::Display;
use motord_bus::{Duration, Instant, clock};
use std::collections::BTreeSet;

/// Things that are logged once for each connection or publisher.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Remark {
    /// Samples lack a quantity.
    Incomplete,
    /// One sample is repeated.
    Stuck,
    /// Intact frames hold no sample.
    OtherContent,
    /// Bytes arrive, and no samples.
    NoSamples,
    /// The rate of the samples was compared with the configured one.
    Rate,
    /// The times of the samples do not fit the clock.
    Clock,
}

/// The log of one IMU, with a limited number of lines.
#[derive(Debug)]
pub(super) struct ImuLog {
    imu: String,
    limit: LineLimit,
    remarks: BTreeSet<Remark>,
}

impl ImuLog {
    pub(super) fn new(imu: &str) -> Self {
        Self { imu: imu.to_owned(), limit: LineLimit::new(clock::monotonic()), remarks: BTreeSet::new() }
    }

    /// Returns the name of the IMU.
    pub(super) fn imu(&self) -> &str {
        &self.imu
    }

    /// Permits each remark once more: a connection or a publisher is new.
    pub(super) fn restart(&mut self) {
        self.remarks.clear();
    }

    /// Returns whether this remark is the first of its kind since the restart.
    pub(super) fn is_first(&mut self, remark: Remark) -> bool {
        self.remarks.insert(remark)
    }

    /// Returns whether one more line may be logged at `now`, beside remarks.
    pub(super) fn permits(&mut self, now: Instant) -> bool {
        self.limit.permits(now)
    }

    /// Logs why samples are missing or rejected.
    #[cold]
    pub(super) fn warn(&self, text: impl Display) {
        tracing::warn!(imu = self.imu, see = "imu-lost", "{text}");
    }

    /// Logs the text if the remark is the first of its kind since the restart. Otherwise does not
    /// call `text`.
    pub(super) fn remark(&mut self, remark: Remark, text: impl FnOnce() -> String) {
        if self.is_first(remark) {
            self.warn(text());
        }
    }

    #[cfg(test)]
    pub(super) fn has(&self, remark: Remark) -> bool {
        self.remarks.contains(&remark)
    }
}

/// Lines that a device may log at once.
const BURST: u32 = 8;
/// After this time it may log one more.
const REFILL: Duration = Duration::from_secs(10);

/// Permits lines of the log.
#[derive(Debug)]
pub(crate) struct LineLimit {
    left: u32,
    refilled: Instant,
}

impl LineLimit {
    pub(crate) const fn new(now: Instant) -> Self {
        Self { left: BURST, refilled: now }
    }

    /// Returns whether a line may be logged at `now`.
    pub(crate) fn permits(&mut self, now: Instant) -> bool {
        while self.left < BURST && now.since(self.refilled) >= REFILL {
            self.left += 1;
            self.refilled = self.refilled + REFILL;
        }
        if self.left == BURST {
            self.refilled = now;
        }
        let permits = self.left > 0;
        self.left = self.left.saturating_sub(1);
        permits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A device that disconnects every 250 ms for a minute.
    #[test]
    fn flapping_device_does_not_flood_the_log() {
        let mut lines = LineLimit::new(Instant::ZERO);
        let times = (0..240).map(|turn| Instant::from_nanos(turn * 250_000_000));
        assert_eq!(times.filter(|now| lines.permits(*now)).count(), 8 + 5);
        let later = Instant::from_nanos(600_000_000_000);
        assert_eq!((0..20).filter(|_| lines.permits(later)).count(), 8);
    }
}
