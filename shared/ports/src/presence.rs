//! Detects the loss of the files by which clients find a daemon and which prevent a second one.

use crate::instance::InstanceLock;
use crate::service;
use nix::errno::Errno;
use nix::sys::stat::lstat;
use std::path::{Path, PathBuf};

/// The device and the number of a file.
type Identity = (u64, u64);

/// The initial files of a daemon: its lock, its directory, the number that wakes clients and its
/// services, except the service for recorders.
///
/// Files of clients, of a dead predecessor and of unknown programs in the same directory do not
/// count.
#[derive(Debug)]
pub struct Presence(Vec<(PathBuf, Option<Identity>)>);

impl Presence {
    /// Records the files of the daemon that holds `lock`, whose services are open.
    #[must_use]
    pub fn of(lock: &InstanceLock) -> Self {
        let instance = lock.instance();
        let files =
            [lock.path(), instance.root(), instance.futex_path()].into_iter().chain(service::files(instance));
        Self(files.map(|path| (path.clone(), identity(&path).ok())).collect())
    }

    /// Returns the first file that was removed or replaced. A file that the system cannot check,
    /// for lack of memory or permission, does not count: that is no reason to stop a robot. Seven
    /// system calls, which do not block on a file system in memory.
    #[must_use]
    pub fn lost(&self) -> Option<&Path> {
        let lost = self.0.iter().find(|(path, was)| match identity(path) {
            Ok(is) => was.is_some_and(|was| was != is),
            Err(errno) => matches!(errno, Errno::ENOENT | Errno::ENOTDIR | Errno::ELOOP),
        });
        lost.map(|(path, _)| path.as_path())
    }
}

fn identity(path: &Path) -> Result<Identity, Errno> {
    lstat(path).map(|found| (found.st_dev, found.st_ino))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::ClientPorts;
    use crate::daemon::DaemonPorts;
    use crate::instance::Instance;
    use std::fs;

    fn with_daemon(test: impl FnOnce(&Instance, Presence)) {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        let lock = instance.lock().unwrap();
        let _ports = DaemonPorts::open(&lock).unwrap();
        let presence = Presence::of(&lock);
        assert_eq!(presence.lost(), None);
        test(&instance, presence);
    }

    #[test]
    fn daemon_with_removed_files_has_lost_them() {
        for directory in 0..7 {
            with_daemon(|instance, presence| {
                let path = presence.0[directory].0.clone();
                let aside = instance.runtime().join("aside");
                fs::rename(&path, &aside).unwrap();
                assert_eq!(presence.lost(), Some(path.as_path()), "removed");
                if aside.is_dir() { fs::create_dir(&path) } else { fs::write(&path, "") }.unwrap();
                assert_eq!(presence.lost(), Some(path.as_path()), "replaced");
                fs::remove_dir_all(&path).or_else(|_| fs::remove_file(&path)).unwrap();
                fs::rename(&aside, &path).unwrap();
                assert_eq!(presence.lost(), None, "as it was");
            });
        }
    }

    /// A client that ends, or the removal of the files of dead processes, is no loss.
    #[test]
    fn other_changes_in_directory_are_no_loss() {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        let lock = instance.lock().unwrap();
        let _ports = DaemonPorts::open(&lock).unwrap();
        let unknown = instance.root().join("services/m_0.service");
        fs::write(&unknown, "").unwrap();
        let client = ClientPorts::open(instance.attach().unwrap().unwrap()).unwrap();
        let presence = Presence::of(&lock);
        drop(client);
        fs::remove_file(unknown).unwrap();
        assert_eq!(presence.lost(), None);
    }

    /// The last client of a service removes it, and finds it by name.
    #[test]
    fn leaving_client_removes_no_file_of_successor() {
        for is_damaged in [false, true] {
            let directory = tempfile::tempdir_in("/tmp").unwrap();
            let instance = Instance::below(directory.path(), "robot").unwrap();
            let lock = instance.lock().unwrap();
            let ports = DaemonPorts::open(&lock).unwrap();
            let client = ClientPorts::open(instance.attach().unwrap().unwrap()).unwrap();
            drop(ports);
            if is_damaged {
                crate::service::files(&instance).iter().for_each(|path| fs::write(path, "").unwrap());
            } else {
                // As if the next daemon was killed while it opened the services.
                std::mem::forget(lock.opening());
            }
            drop(lock);
            let lock = instance.lock().unwrap();
            let _ports = DaemonPorts::open(&lock).unwrap();
            let presence = Presence::of(&lock);
            drop(client);
            assert_eq!(presence.lost(), None, "damaged: {is_damaged}");
            assert!(ClientPorts::open(instance.attach().unwrap().unwrap()).is_ok());
        }
    }

    #[test]
    fn unreadable_file_is_not_lost() {
        let long = PathBuf::from(format!("/tmp/{}", "x".repeat(300)));
        assert_eq!(identity(&long), Err(Errno::ENAMETOOLONG));
        assert_eq!(Presence(vec![(long, Some((1, 1)))]).lost(), None);
    }
}
