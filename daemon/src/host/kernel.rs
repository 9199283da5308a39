//! The system calls that no safe crate offers. All `unsafe` of the daemon is in this file.

use nix::errno::Errno;
use nix::sched::{CloneFlags, unshare};
use nix::sys::mman::{MapFlags, ProtFlags, mmap};
use std::num::NonZeroUsize;
use std::os::fd::{AsRawFd, BorrowedFd, FromRawFd, OwnedFd, RawFd};
use std::sync::atomic::AtomicU64;

const COUNTER_BYTES: NonZeroUsize = NonZeroUsize::new(size_of::<AtomicU64>()).expect("a counter has bytes");

/// Maps the first eight bytes of `file` as a counter that is shared with other processes that have the file. The mapping
/// stays until the process ends.
///
/// # Errors
///
/// `EINVAL` when the file has another size, or may still shrink: reading past the end of a shrunken file kills.
pub(crate) fn map_counter(file: BorrowedFd<'_>) -> Result<&'static AtomicU64, Errno> {
    use nix::fcntl::{FcntlArg::F_GET_SEALS, SealFlag, fcntl};
    let sealed = SealFlag::from_bits_truncate(fcntl(file, F_GET_SEALS)?).contains(SealFlag::F_SEAL_SHRINK);
    let size = nix::sys::stat::fstat(file)?.st_size;
    if !sealed || usize::try_from(size) != Ok(COUNTER_BYTES.get()) {
        return Err(Errno::EINVAL);
    }
    let protection = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
    // SAFETY: the kernel chooses the address, so nothing of ours is mapped over.
    let address = unsafe { mmap(None, COUNTER_BYTES, protection, MapFlags::MAP_SHARED, file, 0) }?;
    // SAFETY: a mapping is aligned to a page and never unmapped; the file keeps its eight bytes by its seal, any bits are
    // a valid `AtomicU64`, and this process reaches them through this reference only.
    Ok(unsafe { address.cast::<AtomicU64>().as_ref() })
}

/// Most groups of a process, as the kernel bounds them (`NGROUPS_MAX`).
pub(crate) const GROUPS_OF_A_PROCESS_MAX: usize = 65_536;

/// The supplementary groups that the process at the other end of `socket` had when it connected, in `groups`.
///
/// # Errors
///
/// `ENODATA` when no process is known, `ERANGE` when there are more than `groups` holds.
pub(crate) fn peer_groups<'a>(socket: BorrowedFd<'_>, groups: &'a mut [u32]) -> Result<&'a [u32], Errno> {
    let mut bytes = libc::socklen_t::try_from(size_of_val(groups)).map_err(|_| Errno::EINVAL)?;
    let value = groups.as_mut_ptr().cast();
    // SAFETY: `value` points to `bytes` writable bytes, a `gid_t` is a `u32`, and the kernel writes no more than `bytes`, which
    // it sets to the bytes written.
    let status = unsafe {
        libc::getsockopt(socket.as_raw_fd(), libc::SOL_SOCKET, libc::SO_PEERGROUPS, value, &raw mut bytes)
    };
    Errno::result(status)?;
    Ok(&groups[..(bytes as usize / size_of::<u32>()).min(groups.len())])
}

/// Takes ownership of a descriptor that the kernel has just given to this process.
pub(crate) fn adopt(descriptor: RawFd) -> OwnedFd {
    // SAFETY: callers pass a result of `accept4` or `recvmsg`, once; nothing else knows the number yet.
    unsafe { OwnedFd::from_raw_fd(descriptor) }
}

/// Gives the calling thread its own table of descriptors, with `keep` and the standard streams in it. All others stay open
/// for the other threads only: this thread must not use them any more.
///
/// # Errors
///
/// `EPERM` or `ENOSYS` from a sandbox or an old kernel; then the thread still shares all descriptors.
pub(crate) fn keep_only(keep: BorrowedFd<'_>) -> Result<(), Errno> {
    const STANDARD_STREAMS: u32 = 3;
    unshare(CloneFlags::CLONE_FILES)?;
    let keep = keep.as_raw_fd().cast_unsigned();
    for (first, last) in [(STANDARD_STREAMS, keep - 1), (keep + 1, u32::MAX)] {
        if first <= last {
            // SAFETY: it closes no descriptor that is in use: the table is this thread's own since the call above, and by
            // contract the thread uses `keep` only.
            Errno::result(unsafe { libc::close_range(first, last, 0) })?;
        }
    }
    Ok(())
}
