//! The order between forks and the connections of other threads.
//!
//! iceoryx2 has locks for the whole process, which it holds while a connection is opened or ended.
//! A process that is forked meanwhile inherits them locked, and each connection of it would wait
//! for ever. Therefore fork(3) waits until no connection is being opened or ended, and none begins
//! before the fork is over (`pthread_atfork`, pthread_atfork(3)).
//!
//! The registration is the only `unsafe` of this file. `_Fork` and a direct call of clone(2) do not
//! wait.

use std::sync::Once;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Connections that are being opened or ended, and [`FORK`] for each fork.
static GATE: AtomicU32 = AtomicU32::new(0);
/// One fork in [`GATE`].
const FORK: u32 = 1 << 16;
/// Interval between two looks at the gate.
const POLL: Duration = Duration::from_micros(100);
/// Longest wait for the gate. A connection takes milliseconds.
const WAIT_MAX: Duration = Duration::from_secs(1);

/// Opens or ends a connection with `call`, while no thread forks. Waits for 1 s or a little more at
/// most, and then calls all the same. `call` neither forks nor passes the gate again.
pub(crate) fn apart_from_forks<T>(call: impl FnOnce() -> T) -> T {
    static REGISTRATION: Once = Once::new();
    REGISTRATION.call_once(register);
    let enter = || {
        let open = |gate| (gate < FORK).then_some(gate + 1);
        GATE.fetch_update(Ordering::Acquire, Ordering::Relaxed, open).is_ok()
    };
    if !poll(enter) {
        GATE.fetch_add(1, Ordering::Acquire);
    }
    let _leaving = Leaving;
    call()
}

/// Leaves the gate, also in a panic.
struct Leaving;

impl Drop for Leaving {
    fn drop(&mut self) {
        let left = |gate: u32| gate.checked_sub(1);
        // A gate of 0 is that of a process which was forked inside.
        let _ = GATE.fetch_update(Ordering::Release, Ordering::Relaxed, left);
    }
}

/// Tries until `is_done`, for [`WAIT_MAX`] and a [`POLL`] at most.
fn poll(mut is_done: impl FnMut() -> bool) -> bool {
    let end = Instant::now() + WAIT_MAX;
    while !is_done() {
        if Instant::now() >= end {
            return false;
        }
        sleep(POLL);
    }
    true
}

fn register() {
    // SAFETY: the handlers use an atomic number and sleep, and live as long as the library: the C
    // library removes them when it is unloaded. Without memory for them, forks do not wait.
    let _ = unsafe { nix::libc::pthread_atfork(Some(close), Some(open_in_parent), Some(open_in_child)) };
}

extern "C" fn close() {
    GATE.fetch_add(FORK, Ordering::Relaxed);
    poll(|| GATE.load(Ordering::Acquire).is_multiple_of(FORK));
}

extern "C" fn open_in_parent() {
    GATE.fetch_sub(FORK, Ordering::Release);
}

/// The threads of the parent do not exist here.
extern "C" fn open_in_child() {
    GATE.store(0, Ordering::Release);
}
