//! Locks of ports.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Returns the value behind `mutex`. A thread that panicked while it held the lock left a valid
/// value: every write is one assignment.
pub(crate) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
