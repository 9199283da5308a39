//! The interpreter's lock: waiting without it, and the time that it takes to get it back.

use crate::errors::caught;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::PyRuntimeWarning;
use pyo3::prelude::*;
use std::ffi::CString;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, TryLockError};
use std::time::{Duration, Instant};

/// A wait for the lock that costs a controller a cycle or two.
const LONG: Duration = Duration::from_millis(2);
/// A long wait adds this number, a short one subtracts 1.
const WEIGHT: u32 = 4;
/// Sum at which the warning is given: three long waits of a few.
const TOO_MANY: u32 = 9;
/// Switch intervals below this number of seconds are good enough.
const GOOD_INTERVAL: f64 = 0.001;

static WAITS: AtomicU32 = AtomicU32::new(0);
static IS_WARNED: AtomicBool = AtomicBool::new(false);

/// Loads what arrays and mappings need. Later, the exception of a signal's handler in an import would be a panic.
///
/// # Errors
/// numpy cannot be imported.
pub(crate) fn prepare(py: Python<'_>) -> PyResult<()> {
    py.import("numpy")?;
    py.import("collections.abc")?;
    PyArray1::<f64>::zeros(py, 1, false).try_readonly()?;
    Ok(())
}

/// Calls without the interpreter's lock. Warns once when other threads keep the lock too long.
///
/// # Errors
/// The warning, where the program turns warnings into exceptions; an `Error` after a panic.
pub(crate) fn without_lock<T: Send>(py: Python<'_>, call: impl Send + FnOnce() -> T) -> PyResult<T> {
    let (value, ended) = py.detach(|| (caught(call), Instant::now()));
    note(py, ended.elapsed())?;
    value
}

/// Returns the content where no other thread uses it. Never waits: the other thread may need the interpreter's lock to continue.
pub(crate) fn unused<T>(content: &Mutex<T>) -> Option<MutexGuard<'_, T>> {
    match content.try_lock() {
        Ok(content) => Some(content),
        Err(TryLockError::Poisoned(content)) => Some(content.into_inner()),
        Err(TryLockError::WouldBlock) => None,
    }
}

/// Measures the wait for the lock `times` times.
pub(crate) fn probe(py: Python<'_>, times: u32) -> PyResult<()> {
    (0..times).try_for_each(|_| without_lock(py, || std::thread::sleep(Duration::from_micros(50))))
}

fn note(py: Python<'_>, waited: Duration) -> PyResult<()> {
    let before = WAITS.load(Ordering::Relaxed);
    if waited < LONG {
        if before > 0 {
            WAITS.store(before - 1, Ordering::Relaxed);
        }
        return Ok(());
    }
    WAITS.store(before.saturating_add(WEIGHT), Ordering::Relaxed);
    if before.saturating_add(WEIGHT) <= TOO_MANY || IS_WARNED.load(Ordering::Relaxed) {
        return Ok(());
    }
    warn(py, waited)
}

/// Warns if a shorter switch interval helps: other threads exist, and the interval is long.
fn warn(py: Python<'_>, waited: Duration) -> PyResult<()> {
    let interval: f64 = py.import("sys")?.call_method0("getswitchinterval")?.extract()?;
    let threads: usize = py.import("threading")?.call_method0("active_count")?.extract()?;
    if threads < 2 || interval < GOOD_INTERVAL || IS_WARNED.swap(true, Ordering::Relaxed) {
        return Ok(());
    }
    let text = format!(
        "another Python thread kept the interpreter for {:.1} ms, repeatedly, while this one had to continue: call \
         sys.setswitchinterval(0.0005) before motord.connect (now {interval} s), or move that work to another process",
        waited.as_secs_f64() * 1e3
    );
    let text = CString::new(text).unwrap_or_default();
    PyErr::warn(py, &py.get_type::<PyRuntimeWarning>(), &text, 1)
}
