//! The times of a file.

use std::time::{SystemTime, UNIX_EPOCH};

/// Unix time at the zero of `CLOCK_MONOTONIC`. It is constant for a file: setting the clock
/// meanwhile does not distort curves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Origin {
    /// Unix time at the zero of `CLOCK_MONOTONIC`, ns.
    pub unix_ns: u64,
}

impl Origin {
    /// Returns the current origin, where `CLOCK_MONOTONIC` shows `now_ns`.
    #[must_use]
    pub fn now(now_ns: u64) -> Self {
        let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { unix_ns: u64::try_from(unix.as_nanos()).unwrap_or(u64::MAX).saturating_sub(now_ns) }
    }

    /// Returns the Unix time, ns, where `CLOCK_MONOTONIC` shows `time_ns`.
    pub(crate) fn unix(self, time_ns: u64) -> u64 {
        self.unix_ns.saturating_add(time_ns)
    }
}
