//! Panics on request, in builds that show what follows a panic: the feature `panic-on-request`, which no package has.
//!
//! The real-time signals `SIGRTMIN`, `SIGRTMIN + 1` and so on ask the threads of [`THREADS`] in their order. The thread of the
//! log is none of them: without it there is no log, and nothing else.

use signal_hook::flag::register_usize;
use std::io;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock};
use std::time::SystemTime;

/// The names of the threads, as [`threads`](crate::threads) gives them.
const THREADS: [&str; 6] =
    ["main", "motord-cycle", "motord-ipc", "motord-telemetry", "motord-registrar", "motord-reopen"];

/// One more than the place in [`THREADS`] of the thread that was asked; 0 when none was.
static ASKED: LazyLock<Arc<AtomicUsize>> = LazyLock::new(Arc::default);

/// Hears the requests from now on.
///
/// # Errors
///
/// What the system refused.
pub(crate) fn hear_requests() -> io::Result<()> {
    tracing::warn!("this build panics on request: it is for tests, not for robots");
    for place in 0..THREADS.len() {
        register_usize(libc::SIGRTMIN() + place as i32, Arc::clone(&ASKED), place + 1)?;
    }
    Ok(())
}

/// Panics if the calling thread was asked to, once. Standard error tells when, in seconds since 1970: not the log, which may
/// end before it has told everything.
pub(crate) fn panic_if_asked() {
    let asked = ASKED.load(Ordering::Relaxed);
    let Some(thread) = asked.checked_sub(1).map(|place| THREADS[place]) else { return };
    if std::thread::current().name() == Some(thread) {
        ASKED.store(0, Ordering::Relaxed);
        let time = SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
        eprintln!("panics at {:.6}", time.as_secs_f64());
        panic!("asked to");
    }
}
