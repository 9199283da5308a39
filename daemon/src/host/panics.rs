//! Panics on request, for the tests of what follows a panic: the feature `panic-on-request`, which
//! no package has.
//!
//! The real-time signals `SIGRTMIN`, `SIGRTMIN + 1` and so on ask the threads of [`THREADS`] in
//! their order. The thread of the log is not among them: without it there is no log, and nothing
//! else changes.

use signal_hook::flag::register_usize;
use std::io;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock};
use std::time::SystemTime;

/// The names of the threads, as [`threads`](crate::threads) gives them.
const THREADS: [&str; 8] = [
    "main",
    "motord-cycle",
    "motord-ipc",
    "motord-telemetry",
    "motord-registrar",
    "motord-reconnector",
    "motord-stop",
    "motord-owners",
];

/// One more than the index in [`THREADS`] of the thread that was asked; 0 when none was.
static ASKED: LazyLock<Arc<AtomicUsize>> = LazyLock::new(Arc::default);

/// Takes requests from now on.
///
/// # Errors
///
/// The error of the system when it refuses a signal handler.
pub(crate) fn register_requests() -> io::Result<()> {
    tracing::warn!("this build panics on request: it is for tests, not for robots");
    for index in 0..THREADS.len() {
        register_usize(libc::SIGRTMIN() + index as i32, Arc::clone(&ASKED), index + 1)?;
    }
    Ok(())
}

/// Panics once if the calling thread was asked to. Writes the time to standard error, in seconds
/// since 1970, and not to the log, which may end before all of its lines are written.
pub(crate) fn panic_if_asked() {
    let asked = ASKED.load(Ordering::Relaxed);
    let Some(thread) = asked.checked_sub(1).map(|index| THREADS[index]) else { return };
    if std::thread::current().name() == Some(thread) {
        ASKED.store(0, Ordering::Relaxed);
        let time = SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
        eprintln!("panics at {:.6}", time.as_secs_f64());
        panic!("asked to");
    }
}
