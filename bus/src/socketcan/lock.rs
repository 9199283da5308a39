//! One daemon per interface: two would command the same motors.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};

use super::{InterfaceName, errno};

/// Exclusive use of an interface among the processes that share a runtime directory. Released when dropped, and by the
/// kernel when the process ends in any way.
#[derive(Debug)]
pub struct InterfaceLock {
    _file: Flock<File>,
}

/// Why an interface could not be locked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum LockError {
    /// Another process has it.
    #[error("{interface} is in use by {}; stop that process first", Holder(*pid))]
    Held {
        /// The interface.
        interface: InterfaceName,
        /// The process that holds the lock; `None` in the moment before it wrote its number.
        pid: Option<u32>,
    },
    /// The lock file cannot be opened or written.
    #[error("lock of {interface}: {errno}")]
    File {
        /// The interface.
        interface: InterfaceName,
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

impl InterfaceLock {
    /// Locks `interface` by the file `<interface>.lock` in `directory`, which must exist and belong to motord. The
    /// file stays behind: removing it would let two processes hold two files of one name.
    ///
    /// # Errors
    ///
    /// [`LockError::Held`] with the holder's process id; [`LockError::File`] when `directory` does not allow it.
    pub fn acquire(directory: &Path, interface: InterfaceName) -> Result<Self, LockError> {
        let failed = |error: &io::Error| LockError::File { interface, errno: errno(error) };
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o640)
            .custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK)
            .open(directory.join(format!("{interface}.lock")))
            .map_err(|error| failed(&error))?;
        match Flock::lock(file, FlockArg::LockExclusiveNonblock) {
            Ok(mut file) => {
                write_pid(&mut file).map_err(|error| failed(&error))?;
                Ok(Self { _file: file })
            }
            Err((mut file, Errno::EWOULDBLOCK)) => {
                Err(LockError::Held { interface, pid: read_pid(&mut file) })
            }
            Err((_, errno)) => Err(LockError::File { interface, errno }),
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
        let first = InterfaceLock::acquire(directory.path(), can0()).unwrap();
        let refused = InterfaceLock::acquire(directory.path(), can0()).unwrap_err();
        assert_eq!(refused, LockError::Held { interface: can0(), pid: Some(std::process::id()) });
        assert!(refused.to_string().contains(&std::process::id().to_string()));
        drop(first);
        InterfaceLock::acquire(directory.path(), can0()).unwrap();
    }

    #[test]
    fn interfaces_are_locked_one_by_one() {
        let directory = tempfile::tempdir().unwrap();
        let _first = InterfaceLock::acquire(directory.path(), can0()).unwrap();
        InterfaceLock::acquire(directory.path(), "can1".parse().unwrap()).unwrap();
    }

    #[test]
    fn a_lock_file_that_lies_gives_no_process_id() {
        let directory = tempfile::tempdir().unwrap();
        let _first = InterfaceLock::acquire(directory.path(), can0()).unwrap();
        for lie in [&b""[..], b"-1", b"99999999999999", &[0xFF; 64]] {
            std::fs::write(directory.path().join("can0.lock"), lie).unwrap();
            let refused = InterfaceLock::acquire(directory.path(), can0()).unwrap_err();
            assert_eq!(refused, LockError::Held { interface: can0(), pid: None });
        }
    }

    #[test]
    fn a_link_in_place_of_the_lock_file_is_not_followed() {
        let directory = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink("/etc/passwd", directory.path().join("can0.lock")).unwrap();
        let refused = InterfaceLock::acquire(directory.path(), can0()).unwrap_err();
        assert_eq!(refused, LockError::File { interface: can0(), errno: Errno::ELOOP });
    }
}
