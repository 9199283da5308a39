//! A configuration file that is watched for changes.

use motord_configuration as config;
use motord_core::cycle::Counters;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;

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
