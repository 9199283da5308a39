//! Signals that end a command, as a flag that the command polls.

use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};
use signal_hook::flag;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Longest time between two checks of the flag in a pause.
const GLANCE: Duration = Duration::from_millis(50);

/// The flag that a signal sets.
#[derive(Debug, Clone)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Registers SIGINT, SIGQUIT, SIGTERM and SIGHUP: they set the flag and no longer end the
    /// process.
    pub fn register() -> Self {
        let flag = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGQUIT, SIGTERM, SIGHUP] {
            flag::register(signal, Arc::clone(&flag)).expect("any process may handle these signals");
        }
        Self(flag)
    }

    /// Returns true after one of the signals arrived.
    pub fn is_raised(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Returns true when a signal arrived since the last call, and clears the flag. A second signal
    /// can end an orderly shutdown early.
    pub fn is_raised_again(&self) -> bool {
        self.0.swap(false, Ordering::Relaxed)
    }

    /// Sleeps until `deadline`, or until a signal arrives.
    pub fn pause_until(&self, deadline: Instant) {
        while !self.is_raised() {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            std::thread::sleep(left.min(GLANCE));
        }
    }
}
