//! Clients that died without leaving.

use motord_bus::{Duration, Instant, clock};
use motord_ports::Housekeeper;
use motord_ports::instance::InstanceLock;
use std::time::SystemTime;

/// Period of the checks whether a client has connected or left: one that is started again and again
/// must find a slot.
const CHECK: Duration = Duration::from_millis(250);
/// Longest time without a cleaning: a connected client waits at most this long for the slot of a
/// dead one. Each cleaning opens files and allocates thousands of times.
const SWEEP: Duration = Duration::from_secs(2);

/// Removes dead clients and their files.
pub struct DeadClients {
    /// `None` where it could not be opened: dead clients keep their slots then.
    housekeeper: Option<Housekeeper>,
    /// When a process last registered itself or left, before the last cleaning.
    changed: Option<SystemTime>,
    checked: Instant,
    cleaned: Instant,
}

impl DeadClients {
    /// Registers this process as the one that cleans up the instance of `lock`. A refusal is
    /// logged.
    #[must_use]
    pub fn open(lock: &InstanceLock) -> Self {
        let housekeeper = Housekeeper::open(lock);
        if let Err(error) = &housekeeper {
            tracing::warn!(see = "dead-clients", "the slots of dead clients cannot be freed: {error}");
        }
        let housekeeper = housekeeper.ok();
        Self { housekeeper, changed: None, checked: Instant::ZERO, cleaned: Instant::ZERO }
    }

    /// Cleans up when a client has connected or left since the last cleaning, or after `SWEEP`. At
    /// most one check in `CHECK`.
    pub fn clean(&mut self) {
        let now = clock::monotonic();
        let Some(housekeeper) = self.housekeeper.as_ref().filter(|_| now.since(self.checked) >= CHECK) else {
            return;
        };
        self.checked = now;
        let changed = housekeeper.changed();
        if changed != self.changed || now.since(self.cleaned) >= SWEEP {
            (self.changed, self.cleaned) = (changed, now);
            let _removed = housekeeper.clean();
        }
    }
}
