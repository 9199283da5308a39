//! Numbers in mapped memory: the first bytes of a file, and a page that the kernel clears in a
//! forked process.
//!
//! The mappings are the only `unsafe` of this file.

use nix::errno::Errno;
use nix::sys::mman::{MapFlags, MmapAdvise, ProtFlags, madvise, mmap, mmap_anonymous, munmap};
use nix::sys::stat::fstat;
use std::fs::File;
use std::num::NonZeroUsize;
use std::os::fd::AsFd;
use std::ptr::{NonNull, null_mut};
use std::sync::atomic::{AtomicPtr, AtomicU32, Ordering};

/// Size of a number.
pub(crate) const BYTES: NonZeroUsize = NonZeroUsize::new(size_of::<AtomicU32>()).expect("a number has bytes");

/// A number in a page of its own. That of a file is shared with every process that maps it.
#[derive(Debug)]
pub(crate) struct Mapping(NonNull<AtomicU32>);

// SAFETY: threads share atomic numbers, and the mapping belongs to no thread.
unsafe impl Send for Mapping {}
// SAFETY: as above.
unsafe impl Sync for Mapping {}

impl Mapping {
    /// Maps the first bytes of `file`.
    ///
    /// # Errors
    /// `EINVAL` when the file is shorter; other errors of the kernel.
    pub(crate) fn of(file: &File, protection: ProtFlags) -> Result<Self, Errno> {
        if usize::try_from(fstat(file)?.st_size).is_ok_and(|bytes| bytes < BYTES.get()) {
            return Err(Errno::EINVAL);
        }
        // SAFETY: the kernel chooses the address, so nothing of ours is mapped over.
        let address = unsafe { mmap(None, BYTES, protection, MapFlags::MAP_SHARED, file.as_fd(), 0) }?;
        Ok(Self(address.cast()))
    }

    /// Maps a private page that is 0, and that the kernel clears in a forked process.
    ///
    /// # Errors
    /// `EINVAL` before Linux 4.14; other errors of the kernel.
    fn cleared_by_fork() -> Result<Self, Errno> {
        let protection = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
        // SAFETY: the kernel chooses the address, so nothing of ours is mapped over.
        let address = unsafe { mmap_anonymous(None, BYTES, protection, MapFlags::MAP_PRIVATE) }?;
        let mapping = Self(address.cast());
        // SAFETY: the page was just mapped, and has no other user.
        unsafe { madvise(address, BYTES.get(), MmapAdvise::MADV_WIPEONFORK) }?;
        Ok(mapping)
    }

    pub(crate) fn word(&self) -> &AtomicU32 {
        // SAFETY: a mapping is aligned to a page and lives as long as `self`; any bits are a
        // number. The file's owner is trusted not to shorten it.
        unsafe { self.0.as_ref() }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: no borrow of the number is left, and the whole mapping is removed.
        let _never_refused = unsafe { munmap(self.0.cast(), BYTES.get()) };
    }
}

/// Returns the number of this process that the kernel sets to 0 in a forked process. Maps it in the
/// first call. Takes no lock: a process that was forked during the first call must not wait for it.
/// `None` on a kernel without such pages.
pub(crate) fn cleared_by_fork() -> Option<&'static AtomicU32> {
    static WORD: AtomicPtr<AtomicU32> = AtomicPtr::new(null_mut());
    let known = NonNull::new(WORD.load(Ordering::Acquire));
    let word = known.or_else(|| {
        let mapped = Mapping::cleared_by_fork().ok()?;
        let address = mapped.0;
        match WORD.compare_exchange(null_mut(), address.as_ptr(), Ordering::AcqRel, Ordering::Acquire) {
            Ok(_) => {
                std::mem::forget(mapped);
                Some(address)
            }
            // Another thread was faster.
            Err(other) => NonNull::new(other),
        }
    })?;
    // SAFETY: the address in `WORD` is that of a mapping that is never removed.
    Some(unsafe { word.as_ref() })
}
