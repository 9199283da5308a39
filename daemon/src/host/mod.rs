//! This machine: the log, the watchdog of systemd, and panics on request.

pub mod log;
#[cfg(feature = "panic-on-request")]
pub(crate) mod panics;

use motord_bus::{Duration, Instant, clock};
use motord_realtime::systemd;

/// Period of feeding the watchdog: half of `WatchdogSec=` of the unit.
const WATCHDOG_PERIOD: Duration = Duration::from_secs(1);

/// Feeds the watchdog of systemd, from a thread that never waits for another one.
#[derive(Debug)]
pub struct Watchdog {
    fed: Instant,
    cycle: u64,
}

impl Watchdog {
    /// Begins with the first cycle.
    #[must_use]
    pub fn new() -> Self {
        Self { fed: clock::monotonic(), cycle: 0 }
    }

    /// Feeds it once a second while `cycle`, the number of the newest cycle, moves: a watchdog that
    /// is fed by a thread of its own proves nothing.
    pub fn feed(&mut self, cycle: u64) {
        let now = clock::monotonic();
        if now.since(self.fed) < WATCHDOG_PERIOD {
            return;
        }
        self.fed = now;
        if cycle != std::mem::replace(&mut self.cycle, cycle) {
            systemd::feed_watchdog();
        }
    }
}

impl Default for Watchdog {
    fn default() -> Self {
        Self::new()
    }
}
