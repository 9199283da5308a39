//! Detects that a daemon which does not answer is dead.

use crate::instance::{Instance, pid_namespace};
use crate::lock_file::{Locks, exclusive};
use crate::stop_socket;
use nix::errno::Errno;
use nix::sys::socket::{SockFlag, connect};
use std::os::fd::AsRawFd;

/// The namespace of all processes of a computer (`PROC_PID_INIT_INO` of the kernel).
const ALL_PROCESSES: u64 = 0xEFFF_FFFC;

/// Returns `true` if no daemon runs `instance`, and `false` if one runs or that is unknown. The
/// kernel removes a daemon's lock when it kills the daemon, so a dead process that no parent has
/// waited for is dead.
///
/// In a namespace of processes, the locks of other namespaces are invisible. There a daemon counts
/// as dead only if no process listens for emergency stops either. That is wrong for a frozen daemon
/// in another namespace of processes and another namespace of the network. Reads files, and does
/// not block.
#[must_use]
pub fn is_dead(instance: &Instance) -> bool {
    match exclusive(&instance.lock_path()) {
        Locks::Held { .. } | Locks::Unknown => false,
        Locks::Free => pid_namespace() == ALL_PROCESSES || !is_listening(instance),
    }
}

/// Returns `true` if a process has the name of the emergency stop's socket, or that is unknown.
fn is_listening(instance: &Instance) -> bool {
    let asked = stop_socket::address(instance).and_then(|address| {
        let socket = stop_socket::open(SockFlag::SOCK_NONBLOCK)?;
        connect(socket.as_raw_fd(), &address)
    });
    asked != Err(Errno::ECONNREFUSED)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instance::InstanceError;
    use nix::fcntl::{Flock, FlockArg};
    use std::fs::File;

    #[test]
    fn daemon_without_lock_is_dead() {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        assert!(!is_dead(&instance), "unknown: it never ran");
        let lock = instance.lock().unwrap();
        assert!(!is_dead(&instance));
        drop(lock);
        assert!(is_dead(&instance));
    }

    /// A member who locks the directory keeps other clients out. They must not conclude that no
    /// daemon runs: the robot may move.
    #[test]
    fn client_learns_who_locked_the_directory() {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        let daemon = instance.lock().unwrap();
        let root = instance.root();
        let _held = Flock::lock(File::open(&root).unwrap(), FlockArg::LockExclusiveNonblock).unwrap();
        let attached = instance.attach().map(|attachment| attachment.is_some());
        assert_eq!(attached, Ok(false), "the daemon itself holds it while it starts");
        drop(daemon);
        let refused = instance.attach().map(drop).unwrap_err();
        assert_eq!(refused, InstanceError::Locked { path: root, pid: std::process::id() });
    }
}
