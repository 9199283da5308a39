//! Work that keeps a running daemon reachable. None of it is urgent; all of it runs on the
//! telemetry thread.
//!
//! | type | job |
//! |---|---|
//! | [`DeadClients`] | removes clients that died, so that others find a slot |
//! | [`DirectoryGuard`] | stops the robot when no client can reach the daemon any more |
//! | [`ConfigWatch`] | reports a configuration file that changed since the start |

use motord_bus::{Duration, Instant, clock};
use motord_configuration as config;
use motord_core::cycle::Counters;
use motord_ports::instance::InstanceLock;
use motord_ports::{Housekeeper, Presence};
use motord_shared::Cause;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Arc, OnceLock};
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

/// Stops the robot when one of the files is removed or replaced: no new client could stop it.
pub struct DirectoryGuard {
    /// `None` once a file was lost.
    presence: Option<Presence>,
    lost: Arc<OnceLock<PathBuf>>,
    counters: Arc<Counters>,
}

impl DirectoryGuard {
    /// Guards the files of `presence`.
    #[must_use]
    pub fn new(presence: Presence, counters: Arc<Counters>) -> Self {
        Self { presence: Some(presence), lost: Arc::default(), counters }
    }

    /// Where the first file that was lost will be.
    #[must_use]
    pub fn lost(&self) -> Arc<OnceLock<PathBuf>> {
        Arc::clone(&self.lost)
    }

    /// Checks the files: some system calls that do not block. `ends` returns whether the daemon
    /// ends; it then removes its files itself.
    pub fn check(&mut self, ends: impl Fn() -> bool) {
        let Some(path) = self.presence.as_ref().and_then(Presence::lost).map(Path::to_owned) else { return };
        // Asked after the check of the files: a daemon that ends has its order before it removes
        // them.
        if ends() {
            return;
        }
        tracing::error!(
            see = "directory-lost",
            "{} was removed or replaced: no new client can reach this daemon",
            path.display()
        );
        // The cause is stored first: `lost` makes the main thread order a stop, and that order
        // would be the cause.
        self.counters.alarms.stop(Cause::DirectoryLost);
        let _not_the_first = self.lost.set(path);
        self.presence = None;
    }
}

/// Compares the file with the one that was read at the start.
pub struct ConfigWatch {
    /// The file and its hash at the start; `None` without a file.
    file: Option<(PathBuf, u64)>,
    counters: Arc<Counters>,
}

impl ConfigWatch {
    /// Watches `file`, which had this hash when it was read.
    #[must_use]
    pub fn new(file: Option<(&Path, u64)>, counters: Arc<Counters>) -> Self {
        Self { file: file.map(|(path, hash)| (path.to_owned(), hash)), counters }
    }

    /// Tells clients whether the file has changed, and logs a change once. Reads the file.
    pub fn check(&self) {
        let Some((path, hash)) = &self.file else { return };
        let changed = config::has_changed(path, *hash);
        let known = self.counters.config_changed.swap(changed, Ordering::Relaxed);
        if changed && !known {
            tracing::warn!(
                see = "config-changed",
                "{} was changed: it is read again when the daemon is restarted",
                path.display()
            );
        }
    }
}
