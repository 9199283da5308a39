//! The system calls that no safe crate offers. All `unsafe` of this crate is in this file.

use nix::errno::Errno;
use nix::sched::{CloneFlags, unshare};
use std::os::fd::{AsRawFd, BorrowedFd};

/// Puts the calling thread under `SCHED_FIFO`.
///
/// # Errors
///
/// `EPERM` without `CAP_SYS_NICE` or a high enough `RLIMIT_RTPRIO`.
pub(crate) fn schedule_fifo(priority: u8) -> Result<(), Errno> {
    let param = libc::sched_param { sched_priority: i32::from(priority) };
    // SAFETY: pid 0 names the calling thread, and `param` is a fully initialised `sched_param` that
    // outlives the call; the kernel only reads it.
    let status = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const param) };
    Errno::result(status).map(drop)
}

/// Sets the bytes by which each heap of this process grows beyond a request. Every thread has a
/// heap, which is locked as a whole. Other C libraries than glibc have no such setting.
pub fn set_heap_reserve(bytes: u16) {
    #[cfg(target_env = "gnu")]
    // SAFETY: the call changes a number of the allocator, under its lock.
    let _always_set = unsafe { libc::mallopt(libc::M_TOP_PAD, bytes.into()) };
    #[cfg(not(target_env = "gnu"))]
    let _no_setting = bytes;
}

/// Most groups of a process, as the kernel bounds them (`NGROUPS_MAX`).
pub const GROUPS_OF_A_PROCESS_MAX: usize = 65_536;

/// Stores in `groups` the supplementary groups that the peer of `socket` had when it connected.
///
/// # Errors
///
/// `ENODATA` when no process is known, `ERANGE` when there are more than `groups` holds.
pub fn peer_groups<'a>(socket: BorrowedFd<'_>, groups: &'a mut [u32]) -> Result<&'a [u32], Errno> {
    let mut bytes = libc::socklen_t::try_from(size_of_val(groups)).map_err(|_| Errno::EINVAL)?;
    let value = groups.as_mut_ptr().cast();
    // SAFETY: `value` points to `bytes` writable bytes, a `gid_t` is a `u32`, and the kernel writes
    // no more than `bytes`, which it sets to the bytes written.
    let status = unsafe {
        libc::getsockopt(socket.as_raw_fd(), libc::SOL_SOCKET, libc::SO_PEERGROUPS, value, &raw mut bytes)
    };
    Errno::result(status)?;
    Ok(&groups[..(bytes as usize / size_of::<u32>()).min(groups.len())])
}

/// Gives the calling thread a separate table of descriptors, with `keep` and the standard streams
/// in it. All others stay open for the other threads only: this thread must not use them any more.
///
/// # Errors
///
/// `EPERM` or `ENOSYS` from a sandbox or an old kernel: the thread still shares all descriptors.
pub fn keep_only(keep: BorrowedFd<'_>) -> Result<(), Errno> {
    const STANDARD_STREAMS: u32 = 3;
    unshare(CloneFlags::CLONE_FILES)?;
    let keep = keep.as_raw_fd().cast_unsigned();
    for (first, last) in [(STANDARD_STREAMS, keep - 1), (keep + 1, u32::MAX)] {
        if first <= last {
            // SAFETY: it closes no descriptor that is in use: the table is this thread's own since
            // the call above, and by contract the thread uses `keep` only.
            Errno::result(unsafe { libc::close_range(first, last, 0) })?;
        }
    }
    Ok(())
}
