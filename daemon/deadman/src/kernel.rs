//! The system calls that no safe crate offers. All `unsafe` of this crate is in this file.

use nix::errno::Errno;
use nix::sys::mman::{MapFlags, ProtFlags, mmap};
use std::num::NonZeroUsize;
use std::os::fd::{BorrowedFd, FromRawFd, OwnedFd, RawFd};
use std::sync::atomic::AtomicU64;

const COUNTER_BYTES: NonZeroUsize = NonZeroUsize::new(size_of::<AtomicU64>()).expect("a counter has bytes");

/// Maps the first eight bytes of `file` as a counter that is shared with other processes that have
/// the file. The mapping stays until the process ends.
///
/// # Errors
///
/// `EINVAL` when the file has another size, or may still shrink: reading past the end of a shrunken
/// file kills.
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
    // SAFETY: a mapping is aligned to a page and never unmapped; the file keeps its eight bytes by
    // its seal, any bits are a valid `AtomicU64`, and this process reaches them through this
    // reference only.
    Ok(unsafe { address.cast::<AtomicU64>().as_ref() })
}

/// Takes ownership of a descriptor that the kernel has just given to this process.
pub(crate) fn adopt(descriptor: RawFd) -> OwnedFd {
    // SAFETY: callers pass a result of `accept4` or `recvmsg`, once; nothing else knows the number
    // yet.
    unsafe { OwnedFd::from_raw_fd(descriptor) }
}
