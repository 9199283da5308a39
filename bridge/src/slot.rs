//! A place for the newest value, between the motor thread and the threads of a network.

use std::sync::{Condvar, Mutex, PoisonError, TryLockError};
use std::time::Duration;

/// Holds one value. A newer value replaces one that was not taken. The lock protects one assignment
/// and is never held during any other call.
#[derive(Debug)]
pub(crate) struct Slot<T> {
    value: Mutex<Option<T>>,
    filled: Condvar,
}

impl<T> Default for Slot<T> {
    fn default() -> Self {
        Self { value: Mutex::new(None), filled: Condvar::new() }
    }
}

impl<T> Slot<T> {
    /// Stores `value`. Waits at most for an assignment by another thread.
    pub(crate) fn put(&self, value: T) {
        let replaced = self.value.lock().unwrap_or_else(PoisonError::into_inner).replace(value);
        self.filled.notify_one();
        drop(replaced);
    }

    /// Stores `value`, unless another thread uses the slot at this moment. Never waits: for a
    /// periodic value, whose next one follows soon.
    pub(crate) fn offer(&self, value: T) {
        let replaced = match self.value.try_lock() {
            Ok(mut slot) => slot.replace(value),
            Err(TryLockError::Poisoned(slot)) => slot.into_inner().replace(value),
            Err(TryLockError::WouldBlock) => return,
        };
        self.filled.notify_one();
        drop(replaced);
    }

    /// Takes the newest value, unless another thread uses the slot at this moment. Never waits.
    pub(crate) fn try_take(&self) -> Option<T> {
        match self.value.try_lock() {
            Ok(mut slot) => slot.take(),
            Err(TryLockError::Poisoned(slot)) => slot.into_inner().take(),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// Takes the newest value; waits for one at most for `timeout`.
    pub(crate) fn wait(&self, timeout: Duration) -> Option<T> {
        let slot = self.value.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.filled.wait_timeout_while(slot, timeout, |slot| slot.is_none());
        waited.unwrap_or_else(PoisonError::into_inner).0.take()
    }
}

impl<T: Clone> Slot<T> {
    /// Returns the newest value and leaves it. Waits at most for an assignment by another thread.
    pub(crate) fn newest(&self) -> Option<T> {
        self.value.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newer_value_replaces_older_one() {
        let slot = Slot::default();
        (1..=1000).for_each(|number| slot.put(number));
        assert_eq!((slot.try_take(), slot.try_take()), (Some(1000), None));
    }

    #[test]
    fn reader_that_hangs_never_blocks_the_writer() {
        let slot = Slot::default();
        let held = slot.value.lock().unwrap();
        slot.offer(1);
        assert_eq!(slot.try_take(), None);
        drop(held);
        slot.offer(2);
        assert_eq!(slot.wait(Duration::ZERO), Some(2));
    }

    #[test]
    fn waiting_reader_gets_value_of_other_thread() {
        let slot = Slot::default();
        std::thread::scope(|scope| {
            scope.spawn(|| slot.put(7));
            assert_eq!(slot.wait(Duration::from_secs(60)), Some(7));
        });
    }
}
