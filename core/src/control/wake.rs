//! The beginning of a cycle.

use motord_bus::{Duration, Instant};

/// The beginning of a cycle: tick and time of the wake-up.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Wake {
    /// Its number, from 1.
    pub cycle: u64,
    /// When the cycle should begin: the tick that its thread slept until. Missed ticks come after
    /// it.
    pub scheduled: Instant,
    /// When it began.
    pub begun: Instant,
    /// Ticks missed just before it.
    pub missed_ticks: u64,
    /// Total time that the computer was suspended since it was started.
    pub suspended: Duration,
}
