//! The clock of every time stamp that crosses the process boundary.

use nix::time::{ClockId, clock_gettime};

/// Returns the current `CLOCK_MONOTONIC`, ns. Never allocates or blocks.
#[must_use]
pub fn now_ns() -> u64 {
    let now = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("every Linux kernel has CLOCK_MONOTONIC");
    now.tv_sec().unsigned_abs() * 1_000_000_000 + now.tv_nsec().unsigned_abs()
}
