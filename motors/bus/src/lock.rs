//! One daemon per bus: two would command the same motors.
//!
//! A lock is a listening Unix socket with an abstract name. There is no file that another process
//! could delete or replace, and the name disappears with its process. Such names belong to a
//! network namespace, as CAN interfaces do.

use std::os::fd::{AsRawFd, OwnedFd};
use std::path::Path;

use nix::errno::Errno;
use nix::sys::socket::{
    AddressFamily, Backlog, SockFlag, SockType, UnixAddr, bind, connect, getsockopt, listen, socket, sockopt,
};

use crate::socketcan::InterfaceName;

/// Most bytes of a device's path in the name of its lock, which may have 107 bytes. Only the end of
/// a longer path is used.
const NAME_BYTES_MAX: usize = 64;

/// Exclusive use of a CAN interface or a serial device among the processes of a network namespace.
/// Released when dropped, and by the kernel when the process ends for any reason.
#[derive(Debug)]
pub struct BusLock {
    _socket: OwnedFd,
}

/// Reason for which a bus could not be locked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LockError {
    /// Another process holds the lock.
    #[error("{bus} is in use by {holder}; stop that process first")]
    Held {
        /// The interface or the device.
        bus: String,
        /// The process that holds the lock.
        holder: Holder,
    },
    /// The kernel returned an error for the socket.
    #[error("lock of {bus}: {errno}")]
    System {
        /// The interface or the device.
        bus: String,
        /// The error of the kernel.
        errno: Errno,
    },
}

/// The process that holds a bus. `None` when it is in another process namespace, or is just taking
/// the lock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Holder(pub Option<u32>);

impl core::fmt::Display for Holder {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.0 {
            Some(pid) => write!(f, "process {pid}"),
            None => f.write_str("another process"),
        }
    }
}

impl BusLock {
    /// Locks `interface`. Every process in its network namespace may do so.
    ///
    /// # Errors
    ///
    /// [`LockError::Held`] with the holder; [`LockError::System`] when the kernel provides no
    /// socket.
    pub fn interface(interface: InterfaceName) -> Result<Self, LockError> {
        Self::acquire(interface.as_str(), &name_of_interface(interface.as_str()))
    }

    /// Locks the serial port `device`. A symbolic link is followed: a device has one lock under all its names.
    ///
    /// # Errors
    ///
    /// As [`interface`](Self::interface).
    pub fn device(device: &str) -> Result<Self, LockError> {
        Self::acquire(device, &name_of_device(device))
    }

    /// Returns the holder of the CAN interface `interface`; `None` when it is free. Neither blocks
    /// nor waits for the holder; three system calls.
    #[must_use]
    pub fn holder_of_interface(interface: &str) -> Option<Holder> {
        holder(&UnixAddr::new_abstract(&name_of_interface(interface)).ok()?)
    }

    /// Returns the holder of the serial port `device`; `None` when it is free. Like
    /// [`holder_of_interface`](Self::holder_of_interface), and it resolves the path.
    #[must_use]
    pub fn holder_of_device(device: &str) -> Option<Holder> {
        holder(&UnixAddr::new_abstract(&name_of_device(device)).ok()?)
    }

    fn acquire(bus: &str, name: &[u8]) -> Result<Self, LockError> {
        let failed = |errno| LockError::System { bus: bus.to_owned(), errno };
        let address = UnixAddr::new_abstract(name).map_err(failed)?;
        let socket = open().map_err(failed)?;
        match bind(socket.as_raw_fd(), &address) {
            Ok(()) => {}
            Err(Errno::EADDRINUSE) => {
                let holder = holder(&address).unwrap_or(Holder(None));
                return Err(LockError::Held { bus: bus.to_owned(), holder });
            }
            Err(errno) => return Err(failed(errno)),
        }
        // Each side of a connection sees the other's credentials.
        listen(&socket, Backlog::MAXCONN).map_err(failed)?;
        Ok(Self { _socket: socket })
    }
}

fn name_of_interface(interface: &str) -> Vec<u8> {
    [b"motord/can/", interface.as_bytes()].concat()
}

fn name_of_device(device: &str) -> Vec<u8> {
    // A missing device is locked under the path that the caller gave.
    let path = Path::new(device).canonicalize().unwrap_or_else(|_| device.into());
    let bytes = path.as_os_str().as_encoded_bytes();
    [b"motord/serial/", &bytes[bytes.len().saturating_sub(NAME_BYTES_MAX)..]].concat()
}

fn open() -> nix::Result<OwnedFd> {
    let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
    socket(AddressFamily::Unix, SockType::Stream, flags, None)
}

/// Returns the process that listens at `address`. The kernel stores its credentials, so it need not
/// accept connections.
fn holder(address: &UnixAddr) -> Option<Holder> {
    let socket = open().ok()?;
    match connect(socket.as_raw_fd(), address) {
        Ok(()) => {
            let pid = getsockopt(&socket, sockopt::PeerCredentials).map_or(0, |peer| peer.pid());
            Some(Holder(u32::try_from(pid).ok().filter(|pid| *pid != 0)))
        }
        // The backlog is full of such connections, which the holder never accepts.
        Err(Errno::EAGAIN) => Some(Holder(None)),
        Err(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a name that no other test and no interface uses.
    fn interface(place: u32) -> InterfaceName {
        format!("t{}-{place}", std::process::id()).parse().unwrap()
    }

    #[test]
    fn second_holder_learns_process_of_first() {
        let name = interface(0);
        assert_eq!(BusLock::holder_of_interface(name.as_str()), None);
        let first = BusLock::interface(name).unwrap();
        let holder = Holder(Some(std::process::id()));
        assert_eq!(BusLock::holder_of_interface(name.as_str()), Some(holder));
        let refused = BusLock::interface(name).unwrap_err();
        assert_eq!(refused, LockError::Held { bus: name.as_str().into(), holder });
        assert!(refused.to_string().contains(&std::process::id().to_string()));
        drop(first);
        BusLock::interface(name).unwrap();
    }

    #[test]
    fn interfaces_are_locked_one_by_one() {
        let _first = BusLock::interface(interface(1)).unwrap();
        BusLock::interface(interface(2)).unwrap();
    }

    #[test]
    fn device_has_one_lock_under_all_names() {
        let directory = tempfile::tempdir().unwrap();
        let (device, link) = (directory.path().join("device"), directory.path().join("adapter"));
        std::fs::write(&device, "").unwrap();
        std::os::unix::fs::symlink(&device, &link).unwrap();
        let (device, link) = (device.to_str().unwrap(), link.to_str().unwrap());
        let first = BusLock::device(link).unwrap();
        let holder = Holder(Some(std::process::id()));
        assert_eq!(BusLock::device(device).unwrap_err(), LockError::Held { bus: device.into(), holder });
        assert_eq!(BusLock::holder_of_device(device), Some(holder));
        drop(first);
        BusLock::device(device).unwrap();
        BusLock::device(&format!("/dev/serial/by-id/{}", "x".repeat(300))).unwrap();
    }

    #[test]
    fn repeatedly_requested_lock_still_holds() {
        let name = interface(3);
        let _held = BusLock::interface(name).unwrap();
        let asked: Vec<_> = (0..5000).map(|_| BusLock::interface(name)).collect();
        assert!(asked.iter().all(|lock| matches!(lock, Err(LockError::Held { .. }))));
    }
}
