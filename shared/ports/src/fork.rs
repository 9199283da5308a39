//! Values that belong to the process that created them.
//!
//! A forked process inherits the memory, the descriptors and the mappings of its parent. If it used
//! or dropped a port, it would change what belongs to the parent: the state of a queue, a file, a
//! claim. A [`ForkGuard`] prevents both.
//!
//! The kernel detects the fork: it clears a page (`MADV_WIPEONFORK`, madvise(2)) in every process
//! with a copy of the memory, whichever call created it. A process that shares the memory is not
//! distinguished: one of vfork(2), or of clone(2) with `CLONE_VM`. It may only call `execve` or
//! `_exit`.

use crate::fork_gate::apart_from_forks;
use crate::mapping::cleared_by_fork;
use std::mem::forget;
use std::sync::atomic::{AtomicU32, Ordering};

/// A process that uses what its parent created.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Forked;

/// The process that created a value.
#[derive(Debug, Clone, Copy)]
pub struct Creator(Identity);

/// Distinguishes a process from those that it was forked from.
#[derive(Debug, Clone, Copy)]
enum Identity {
    /// The number of the process, and the page that has it while the process is the same.
    Number(&'static AtomicU32, u32),
    /// The process id, on a kernel that clears no page.
    Id(u32),
}

impl Creator {
    /// Returns the calling process. Takes no lock, and makes system calls in its first call of a
    /// process only.
    #[must_use]
    pub fn this() -> Self {
        Self(cleared_by_fork().map_or_else(|| Identity::Id(std::process::id()), numbered))
    }

    /// Checks that the calling process is this one. Async-signal-safe. Makes no system call, except
    /// on a kernel before Linux 4.14, which needs one.
    ///
    /// # Errors
    /// [`Forked`].
    #[inline]
    pub fn check(self) -> Result<(), Forked> {
        let is_same = match self.0 {
            Identity::Number(word, number) => word.load(Ordering::Relaxed) == number,
            Identity::Id(id) => std::process::id() == id,
        };
        if is_same { Ok(()) } else { Err(Forked) }
    }
}

/// Returns the number in `word`, and sets one that no ancestor has where it was cleared.
fn numbered(word: &'static AtomicU32) -> Identity {
    /// The number of this process or, in a forked one, of the ancestor that set it last.
    static LAST: AtomicU32 = AtomicU32::new(0);
    let mut number = word.load(Ordering::Relaxed);
    if number == 0 {
        let next = LAST.fetch_add(1, Ordering::Relaxed) + 1;
        let set = word.compare_exchange(0, next, Ordering::Relaxed, Ordering::Relaxed);
        number = set.map_or_else(|other| other, |_| next);
    }
    Identity::Number(word, number)
}

/// A value that only the process that created it can use. Elsewhere it is neither used nor dropped.
#[derive(Debug)]
pub struct ForkGuard<T> {
    /// `None` while it is dropped only.
    value: Option<T>,
    creator: Creator,
}

impl<T> ForkGuard<T> {
    /// Opens a value with `open` and binds it to the calling process. A fork in another thread
    /// waits until it is open.
    ///
    /// # Errors
    /// Those of `open`.
    pub fn open<E>(open: impl FnOnce() -> Result<T, E>) -> Result<Self, E> {
        let value = Some(apart_from_forks(open)?);
        Ok(Self { value, creator: Creator::this() })
    }

    /// Returns the value. Allocates nothing, and makes no system call: see [`Creator::check`].
    ///
    /// # Errors
    /// [`Forked`] in a process that was forked from the one that created the value.
    #[inline]
    pub fn get(&self) -> Result<&T, Forked> {
        self.creator.check()?;
        self.value.as_ref().ok_or(Forked)
    }
}

impl<T> Drop for ForkGuard<T> {
    fn drop(&mut self) {
        let value = self.value.take();
        match self.creator.check() {
            Ok(()) => apart_from_forks(|| drop(value)),
            Err(Forked) => forget(value),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A page as the kernel clears it.
    fn page() -> &'static AtomicU32 {
        Box::leak(Box::default())
    }

    #[test]
    fn forked_process_has_a_number_of_its_own() {
        let word = page();
        let parent = Creator(numbered(word));
        assert_eq!((parent.check(), Creator(numbered(word)).check()), (Ok(()), Ok(())));
        word.store(0, Ordering::Relaxed);
        assert_eq!(parent.check(), Err(Forked), "before the child has a number");
        let child = Creator(numbered(word));
        assert_eq!((parent.check(), child.check()), (Err(Forked), Ok(())));
        word.store(0, Ordering::Relaxed);
        let grandchild = Creator(numbered(word));
        assert_eq!([parent, child, grandchild].map(Creator::check), [Err(Forked), Err(Forked), Ok(())]);
    }

    #[test]
    fn foreign_value_is_neither_used_nor_dropped() {
        struct Panics;
        impl Drop for Panics {
            fn drop(&mut self) {
                panic!("the value of another process was dropped");
            }
        }
        let word = page();
        let guard = ForkGuard { value: Some(Panics), creator: Creator(numbered(word)) };
        assert!(guard.get().is_ok());
        word.store(0, Ordering::Relaxed);
        assert!(guard.get().is_err());
        drop(guard);
        let other = Creator(Identity::Id(std::process::id() + 1));
        assert_eq!((other.check(), Creator(Identity::Id(std::process::id())).check()), (Err(Forked), Ok(())));
    }

    #[test]
    fn own_value_is_dropped_once() {
        let (value, kept) = (std::sync::Arc::new(()), std::sync::Arc::new(()));
        let held = std::sync::Arc::clone(&value);
        drop(ForkGuard::open(|| Ok::<_, Forked>(held)));
        let guard = ForkGuard::open(|| Ok::<_, Forked>(std::sync::Arc::clone(&kept))).unwrap();
        assert_eq!(guard.get().map(std::sync::Arc::strong_count), Ok(2));
        assert_eq!((std::sync::Arc::strong_count(&value), std::sync::Arc::strong_count(&kept)), (1, 2));
    }
}
