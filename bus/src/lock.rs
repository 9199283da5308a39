//! One daemon per bus: two would command the same motors.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};

use crate::kernel::errno;
use crate::socketcan::InterfaceName;

/// Exclusive use of a CAN interface or a serial device among the processes that share a runtime directory. Released when
/// dropped, and by the kernel when the process ends in any way.
#[derive(Debug)]
pub struct BusLock {
    _file: Flock<File>,
}

/// Why a bus could not be locked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LockError {
    /// Another process has it.
    #[error("{bus} is in use by {}; stop that process first", Holder(*pid))]
    Held {
        /// The interface or the device.
        bus: String,
        /// The process that holds the lock; `None` in the moment before it wrote its number.
        pid: Option<u32>,
    },
    /// The lock file cannot be opened or written.
    #[error("lock of {bus}: {errno}")]
    File {
        /// The interface or the device.
        bus: String,
        /// The error of the kernel.
        errno: Errno,
    },
}

struct Holder(Option<u32>);

impl core::fmt::Display for Holder {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.0 {
            Some(pid) => write!(f, "process {pid}"),
            None => f.write_str("another process"),
        }
    }
}

impl BusLock {
    /// Locks `interface` by the file `<interface>.lock` in `directory`, which must exist and belong to motord. The
    /// file stays behind: removing it would let two processes hold two files of one name.
    ///
    /// # Errors
    ///
    /// [`LockError::Held`] with the holder's process id; [`LockError::File`] when `directory` does not allow it.
    pub fn interface(directory: &Path, interface: InterfaceName) -> Result<Self, LockError> {
        Self::acquire(directory, interface.as_str(), interface.as_str())
    }

    /// Locks the serial port `device` in the same way. A symbolic link is followed: a device has one lock under all its names. The
    /// file is called after the device, as in `ttyUSB0.lock`.
    ///
    /// # Errors
    ///
    /// As [`interface`](Self::interface).
    pub fn device(directory: &Path, device: &str) -> Result<Self, LockError> {
        // A device that is missing is locked under the name that it is expected under.
        let path = Path::new(device).canonicalize().unwrap_or_else(|_| device.into());
        let name = path.strip_prefix("/dev").unwrap_or(&path).to_string_lossy();
        Self::acquire(directory, device, &name.trim_start_matches('/').replace('/', "-"))
    }

    fn acquire(directory: &Path, bus: &str, name: &str) -> Result<Self, LockError> {
        let failed = |errno| LockError::File { bus: bus.to_owned(), errno };
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o640)
            .custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK)
            .open(directory.join(format!("{name}.lock")))
            .map_err(|error| failed(errno(&error)))?;
        match Flock::lock(file, FlockArg::LockExclusiveNonblock) {
            Ok(mut file) => {
                write_pid(&mut file).map_err(|error| failed(errno(&error)))?;
                Ok(Self { _file: file })
            }
            Err((mut file, Errno::EWOULDBLOCK)) => {
                Err(LockError::Held { bus: bus.to_owned(), pid: read_pid(&mut file) })
            }
            Err((_, errno)) => Err(failed(errno)),
        }
    }
}

fn write_pid(file: &mut File) -> io::Result<()> {
    file.set_len(0)?;
    file.rewind()?;
    writeln!(file, "{}", std::process::id())
}

fn read_pid(file: &mut File) -> Option<u32> {
    const DIGITS: u64 = 11;
    let mut text = String::new();
    file.take(DIGITS).read_to_string(&mut text).ok()?;
    text.trim_end().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn can0() -> InterfaceName {
        "can0".parse().unwrap()
    }

    #[test]
    fn a_second_holder_is_told_the_process_id_of_the_first() {
        let directory = tempfile::tempdir().unwrap();
        let first = BusLock::interface(directory.path(), can0()).unwrap();
        let refused = BusLock::interface(directory.path(), can0()).unwrap_err();
        assert_eq!(refused, LockError::Held { bus: "can0".into(), pid: Some(std::process::id()) });
        assert!(refused.to_string().contains(&std::process::id().to_string()));
        drop(first);
        BusLock::interface(directory.path(), can0()).unwrap();
    }

    #[test]
    fn interfaces_are_locked_one_by_one() {
        let directory = tempfile::tempdir().unwrap();
        let _first = BusLock::interface(directory.path(), can0()).unwrap();
        BusLock::interface(directory.path(), "can1".parse().unwrap()).unwrap();
    }

    #[test]
    fn a_device_has_one_lock_under_all_its_names() {
        let directory = tempfile::tempdir().unwrap();
        let link = directory.path().join("adapter");
        std::os::unix::fs::symlink("/dev/null", &link).unwrap();
        let link = link.to_str().unwrap();
        let first = BusLock::device(directory.path(), link).unwrap();
        let refused = BusLock::device(directory.path(), "/dev/null").unwrap_err();
        assert_eq!(refused, LockError::Held { bus: "/dev/null".into(), pid: Some(std::process::id()) });
        assert!(directory.path().join("null.lock").exists());
        drop(first);
        BusLock::device(directory.path(), "/dev/null").unwrap();
        BusLock::device(directory.path(), "/dev/serial/by-id/../../not-there").unwrap();
    }

    #[test]
    fn a_lock_file_that_lies_gives_no_process_id() {
        let directory = tempfile::tempdir().unwrap();
        let _first = BusLock::interface(directory.path(), can0()).unwrap();
        for lie in [&b""[..], b"-1", b"99999999999999", &[0xFF; 64]] {
            std::fs::write(directory.path().join("can0.lock"), lie).unwrap();
            let refused = BusLock::interface(directory.path(), can0()).unwrap_err();
            assert_eq!(refused, LockError::Held { bus: "can0".into(), pid: None });
        }
    }

    #[test]
    fn a_link_in_place_of_the_lock_file_is_not_followed() {
        let directory = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink("/etc/passwd", directory.path().join("can0.lock")).unwrap();
        let refused = BusLock::interface(directory.path(), can0()).unwrap_err();
        assert_eq!(refused, LockError::File { bus: "can0".into(), errno: Errno::ELOOP });
    }
}
