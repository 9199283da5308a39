//! Robots at 1 kHz, which run one at a time.

mod deaths;
mod demo;

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Robots at 1 kHz on one small machine would change each other's measurements.
static ALONE: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}
