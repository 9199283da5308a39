//! Lines of the log about one device or process, without a flood.

use motord_bus::{Duration, Instant};

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
