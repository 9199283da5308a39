//! A number in a file that counts the published states. Clients sleep on it (`futex(2)`), and may
//! only read it.

use crate::instance::{Instance, InstanceLock};
use crate::instance_error::{InstanceError, refused};
use crate::mapping::{BYTES, Mapping};
use nix::errno::Errno;
use nix::fcntl::posix_fallocate;
use nix::sys::mman::ProtFlags;
use nix::sys::stat::{fstat, lstat};
use rustix::thread::Timespec;
use rustix::thread::futex::{Flags, wait, wake};
use std::path::PathBuf;
use std::sync::atomic::{Ordering, fence};
use std::time::Duration;

/// The daemon's side.
#[derive(Debug)]
pub(crate) struct Waker(Mapping);

impl Waker {
    /// Opens the file of the instance of `lock`, or creates it. The clients of a dead predecessor
    /// sleep on the same file.
    ///
    /// # Errors
    /// The file cannot be created.
    pub(crate) fn open(lock: &InstanceLock) -> Result<Self, InstanceError> {
        let file = lock.make_futex()?;
        // The kernel kills a process that accesses a page without disk space.
        let mapped = posix_fallocate(&file, 0, BYTES.get() as i64)
            .and_then(|()| Mapping::of(&file, ProtFlags::PROT_READ | ProtFlags::PROT_WRITE));
        mapped.map(Self).map_err(|errno| refused(&lock.instance().futex_path(), errno))
    }

    /// Wakes every client that sleeps. One system call; never blocks.
    pub(crate) fn wake(&self) {
        let word = self.0.word();
        // A process that reads the new number also reads what was published before it.
        word.fetch_add(1, Ordering::AcqRel);
        let _awake = wake(word, Flags::empty(), i32::MAX.cast_unsigned());
    }
}

/// The client's side.
#[derive(Debug)]
pub(crate) struct Waiter {
    mapping: Mapping,
    path: PathBuf,
    /// The file: its device and its number there.
    file: (u64, u64),
}

/// The end of a sleep.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Slept {
    /// A state was published; or a spurious wake-up.
    Woken,
    /// The timeout has expired.
    TimedOut,
}

impl Waiter {
    /// Opens the file of `instance`.
    ///
    /// # Errors
    /// `ENOENT` when the daemon does not create this file; `EPERM` when a client created it; other
    /// errors of the kernel.
    pub(crate) fn open(instance: &Instance) -> Result<Self, Errno> {
        let file = instance.open_futex().map_err(|error| match error {
            InstanceError::System { errno, .. } => errno,
            _ => Errno::EPERM,
        })?;
        let mapping = Mapping::of(&file, ProtFlags::PROT_READ)?;
        let found = fstat(&file)?;
        Ok(Self { mapping, path: instance.futex_path(), file: (found.st_dev, found.st_ino) })
    }

    /// Returns whether a daemon that runs wakes it: its file is still the instance's. Does not
    /// allocate; one system call.
    pub(crate) fn is_current(&self) -> bool {
        lstat(&self.path).is_ok_and(|found| (found.st_dev, found.st_ino) == self.file)
    }

    /// Returns the number of states so far, modulo 2³². The states it counts can be read.
    pub(crate) fn count(&self) -> u32 {
        // Read-only memory allows relaxed loads only; the fence adds acquire ordering.
        let count = self.mapping.word().load(Ordering::Relaxed);
        fence(Ordering::Acquire);
        count
    }

    /// Sleeps until more than `seen` states were published, at most `timeout`. One system call.
    ///
    /// # Errors
    /// The error of the kernel.
    pub(crate) fn sleep(&self, seen: u32, timeout: Duration) -> Result<Slept, Errno> {
        let timeout =
            Timespec { tv_sec: timeout.as_secs().cast_signed(), tv_nsec: timeout.subsec_nanos().into() };
        match wait(self.mapping.word(), Flags::empty(), seen, Some(&timeout)) {
            Ok(()) | Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => Ok(Slept::Woken),
            Err(rustix::io::Errno::TIMEDOUT) => Ok(Slept::TimedOut),
            Err(error) => Err(Errno::from_raw(error.raw_os_error())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};

    fn with_lock(test: impl FnOnce(&InstanceLock)) {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        test(&Instance::below(directory.path(), "robot").unwrap().lock().unwrap());
    }

    fn is_woken(waiter: &Waiter, waker: &Waker) -> bool {
        let seen = waiter.count();
        waker.wake();
        waiter.count() == seen.wrapping_add(1)
            && waiter.sleep(seen, Duration::from_secs(60)) == Ok(Slept::Woken)
    }

    #[test]
    fn client_of_dead_daemon_is_woken_by_successor() {
        with_lock(|lock| {
            let first = Waker::open(lock).unwrap();
            let waiter = Waiter::open(lock.instance()).unwrap();
            assert!(is_woken(&waiter, &first) && waiter.is_current());
            drop(first);
            assert!(is_woken(&waiter, &Waker::open(lock).unwrap()));
            fs::remove_file(lock.instance().futex_path()).unwrap();
            assert!(!waiter.is_current());
            let _other = Waker::open(lock).unwrap();
            assert!(!waiter.is_current(), "the file of another daemon");
        });
    }

    #[test]
    fn numberless_file_is_refused_or_completed() {
        with_lock(|lock| {
            let path = lock.instance().futex_path();
            assert_eq!(Waiter::open(lock.instance()).unwrap_err(), Errno::ENOENT);
            fs::write(&path, "abc").unwrap();
            assert_eq!(Waiter::open(lock.instance()).unwrap_err(), Errno::EINVAL);
            let waker = Waker::open(lock).unwrap();
            assert!(is_woken(&Waiter::open(lock.instance()).unwrap(), &waker));
        });
    }

    /// A runtime directory belongs to a group; any of its members may run a second instance there.
    #[test]
    fn client_trusts_owner_of_instance_directory() {
        const OWNER: u32 = 65_534;
        with_lock(|lock| {
            let waker = Waker::open(lock).unwrap();
            // Only root can create a file of another user.
            if std::os::unix::fs::chown(lock.instance().futex_path(), Some(OWNER), None).is_ok() {
                std::os::unix::fs::chown(lock.instance().root(), Some(OWNER), None).unwrap();
                assert!(is_woken(&Waiter::open(lock.instance()).unwrap(), &waker));
            }
        });
    }

    /// Every member may create files beside it.
    #[test]
    fn file_prepared_by_client_is_never_used() {
        const NOBODY: u32 = 65_534;
        with_lock(|lock| {
            let path = lock.instance().futex_path();
            let elsewhere = lock.instance().runtime().join("elsewhere");
            fs::write(&elsewhere, "kept").unwrap();
            symlink(&elsewhere, &path).unwrap();
            assert_eq!(Waiter::open(lock.instance()).unwrap_err(), Errno::ELOOP);
            let waker = Waker::open(lock).unwrap();
            assert!(is_woken(&Waiter::open(lock.instance()).unwrap(), &waker));
            assert_eq!(fs::read(elsewhere).unwrap(), b"kept");
            let other = path.with_extension("other");
            fs::hard_link(&path, &other).unwrap();
            let linked = Waker::open(lock).unwrap();
            assert!(is_woken(&Waiter::open(lock.instance()).unwrap(), &linked));
            assert_eq!(fs::metadata(other).unwrap().nlink(), 1, "the daemon has a file of its own");
            // Only root can create a file of another user.
            if std::os::unix::fs::chown(&path, Some(NOBODY), None).is_ok() {
                assert_eq!(Waiter::open(lock.instance()).unwrap_err(), Errno::EPERM);
                let waker = Waker::open(lock).unwrap();
                assert!(is_woken(&Waiter::open(lock.instance()).unwrap(), &waker));
            }
        });
    }

    /// A writer could prevent wake-ups.
    #[test]
    fn group_reads_number_and_only_owner_writes() {
        with_lock(|lock| {
            let _waker = Waker::open(lock).unwrap();
            let mode = fs::metadata(lock.instance().futex_path()).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o644);
        });
    }
}
