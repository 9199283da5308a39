//! The clock of this machine.

use motord_bus::{Duration, Instant, Readiness, Ready, clock, wait};
use motord_core::clock::Clock;

/// `CLOCK_MONOTONIC`.
#[derive(Debug, Clone, Copy, Default)]
pub struct Monotonic;

impl Clock for Monotonic {
    fn now(&self) -> Instant {
        clock::monotonic()
    }

    fn now_and_suspended(&self) -> (Instant, Duration) {
        clock::monotonic_and_suspended()
    }

    fn sleep_until(&mut self, instant: Instant) {
        clock::sleep_until(instant);
    }

    fn wait(&mut self, readiness: &[Readiness<'_>], until: Instant) -> Ready {
        wait(readiness, clock::monotonic(), until)
    }
}
