//! The file descriptors of this process.

use nix::errno::Errno;
use nix::sys::resource::{Resource, getrlimit};
use std::fs;

/// Upper bound of the descriptors that a client opens when it connects and stops a robot: 21 were
/// counted.
pub(crate) const OF_CONNECTION: u64 = 32;
/// Upper bound of the descriptors that one port of a client opens: 5 were counted.
pub(crate) const OF_PORT: u64 = 8;

/// Returns `true` when this process has fewer than `number` free descriptors. Allocates. A process
/// whose descriptors cannot be counted has enough.
pub(crate) fn are_fewer_than(number: u64) -> bool {
    let used = match fs::read_dir("/proc/self/fd") {
        Ok(entries) => entries,
        Err(error) => return error.raw_os_error().is_some_and(|errno| is_lack(Errno::from_raw(errno))),
    };
    let Ok((limit, _)) = getrlimit(Resource::RLIMIT_NOFILE) else { return false };
    // A lowered limit closes no descriptor above it.
    let counts = |name: &fs::DirEntry| {
        name.file_name()
            .to_str()
            .and_then(|number| number.parse().ok())
            .is_some_and(|number: u64| number < limit)
    };
    // One of them is this directory.
    let used = used.flatten().filter(counts).count().saturating_sub(1) as u64;
    limit.saturating_sub(used) < number
}

/// Returns `true` for the errors of a process, or a computer, without free descriptors.
pub(crate) fn is_lack(errno: Errno) -> bool {
    matches!(errno, Errno::EMFILE | Errno::ENFILE)
}
