//! The lines of the log about one IMU.

use super::line_limit::LineLimit;
use core::fmt::Display;
use motord_bus::{Instant, clock};
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
