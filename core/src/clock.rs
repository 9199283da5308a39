//! The clock of the cycle: the machine's, or one of virtual time.

use motord_bus::{Duration, Instant, Readiness, Ready};

/// Time, and waiting for it.
pub trait Clock {
    /// The present time.
    fn now(&self) -> Instant;

    /// Total time that the computer was suspended since it was started. No system call.
    fn suspended(&self) -> Duration;

    /// Returns at `instant`, or at once when it has passed. At most one system call.
    fn sleep_until(&mut self, instant: Instant);

    /// Returns when a bus has something, or at `until`; returns the buses that have. At most one system call.
    fn wait(&mut self, readiness: &[Readiness<'_>], until: Instant) -> Ready;
}
