//! The heartbeat: a number in shared memory that shows another process that the cycle runs.
//!
//! Each cycle stores its number when it begins. After the last one [`AT_REST`] is stored, if every
//! motor is stopped. The other process only checks that the number changes. It reads the file
//! instead of mapping it, so a change of the file cannot kill it.

use crate::kernel;
use nix::errno::Errno;
use nix::fcntl::{FcntlArg, SealFlag, fcntl};
use nix::sys::memfd::{MFdFlags, memfd_create};
use nix::sys::uio::pread;
use nix::unistd::ftruncate;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::atomic::{AtomicU64, Ordering};

/// The heartbeat while no motor is commanded: before the first cycle, and after the last one of a
/// daemon that has stopped its motors.
pub const AT_REST: u64 = 0;

/// The daemon's end.
#[derive(Debug, Clone, Copy)]
pub struct Heartbeat(&'static AtomicU64);

impl Heartbeat {
    /// Creates a heartbeat at rest, and the file by which other processes read it. One per process:
    /// its memory is never freed.
    ///
    /// # Errors
    ///
    /// The error of the kernel.
    pub fn create() -> Result<(Self, Pulse), Errno> {
        let file = memfd_create("motord-heartbeat", MFdFlags::MFD_CLOEXEC | MFdFlags::MFD_ALLOW_SEALING)?;
        ftruncate(&file, size_of::<AtomicU64>() as i64)?;
        fcntl(&file, FcntlArg::F_ADD_SEALS(SealFlag::F_SEAL_SHRINK | SealFlag::F_SEAL_GROW))?;
        Ok((Self(kernel::map_counter(file.as_fd())?), Pulse(file)))
    }

    /// Cycle number `cycle` begins. Real-time: one plain store.
    pub fn beat(self, cycle: u64) {
        self.0.store(cycle, Ordering::Release);
    }

    /// The motors are stopped and no cycle follows. Real-time: one plain store.
    pub fn rest(self) {
        self.beat(AT_REST);
    }
}

/// Another process's view of a [`Heartbeat`].
#[derive(Debug)]
pub struct Pulse(OwnedFd);

impl Pulse {
    /// Returns the present number; `None` when the file is no heartbeat. Does not allocate; one
    /// system call.
    #[must_use]
    pub fn read(&self) -> Option<u64> {
        let mut bytes = [0; size_of::<u64>()];
        let count = pread(&self.0, &mut bytes, 0).ok()?;
        (count == bytes.len()).then(|| u64::from_ne_bytes(bytes))
    }
}

impl From<OwnedFd> for Pulse {
    fn from(file: OwnedFd) -> Self {
        Self(file)
    }
}

impl AsFd for Pulse {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_beat_is_seen_through_the_file() {
        let (heartbeat, pulse) = Heartbeat::create().unwrap();
        assert_eq!(pulse.read(), Some(AT_REST));
        heartbeat.beat(7);
        assert_eq!(pulse.read(), Some(7));
        heartbeat.rest();
        assert_eq!(pulse.read(), Some(AT_REST));
    }

    #[test]
    fn no_process_can_truncate_memory_under_the_cycle() {
        let (_heartbeat, pulse) = Heartbeat::create().unwrap();
        assert_eq!(ftruncate(&pulse, 0), Err(Errno::EPERM));
        let unsealed = memfd_create("test", MFdFlags::MFD_ALLOW_SEALING).unwrap();
        ftruncate(&unsealed, 8).unwrap();
        assert!(kernel::map_counter(unsealed.as_fd()).is_err());
    }

    #[test]
    fn file_without_heartbeat_has_no_pulse() {
        let file = memfd_create("test", MFdFlags::empty()).unwrap();
        assert_eq!(Pulse::from(file).read(), None);
    }
}
