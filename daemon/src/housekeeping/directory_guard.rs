//! The files by which clients find the daemon.

use motord_core::cycle::Counters;
use motord_ports::Presence;
use motord_shared::Cause;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

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
