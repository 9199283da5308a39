//! A clock of virtual time.

use crate::readiness::{Clock, Readiness, Ready};
use crate::time::{Duration, Instant};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Virtual time, which advances only when the cycle sleeps or waits. Clones share the time.
#[derive(Debug, Clone, Default)]
pub struct VirtualClock(Arc<AtomicU64>);

impl VirtualClock {
    /// Returns a clock that shows `start`.
    #[must_use]
    pub fn new(start: Instant) -> Self {
        Self(Arc::new(AtomicU64::new(start.as_nanos())))
    }
}

impl Clock for VirtualClock {
    fn now(&self) -> Instant {
        Instant::from_nanos(self.0.load(Ordering::Relaxed))
    }

    fn now_and_suspended(&self) -> (Instant, Duration) {
        (self.now(), Duration::ZERO)
    }

    fn sleep_until(&mut self, instant: Instant) {
        self.0.fetch_max(instant.as_nanos(), Ordering::Relaxed);
    }

    fn wait(&mut self, readiness: &[Readiness<'_>], until: Instant) -> Ready {
        let due = |readiness: &Readiness<'_>| match *readiness {
            Readiness::At(at) => at,
            Readiness::Readable(_) | Readiness::Never => Instant::FAR_FUTURE,
        };
        self.sleep_until(readiness.iter().map(due).fold(until, Instant::min));
        let now = self.now();
        Ready::of(readiness.iter().map(|readiness| due(readiness) <= now))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn virtual_time_moves_to_first_due_bus() {
        let mut clock = VirtualClock::new(Instant::from_nanos(100));
        let at = |nanos| Readiness::At(Instant::from_nanos(nanos));
        let ready = clock.wait(&[at(300), Readiness::Never, at(200)], Instant::from_nanos(250));
        assert_eq!(clock.clone().now(), Instant::from_nanos(200));
        assert_eq!([0, 1, 2].map(|bus| ready.contains(bus)), [false, false, true]);
        clock.sleep_until(Instant::from_nanos(50));
        assert_eq!(clock.now(), Instant::from_nanos(200));
        assert!(!clock.wait(&[at(300)], Instant::from_nanos(250)).any());
        assert_eq!(clock.now(), Instant::from_nanos(250));
    }
}
