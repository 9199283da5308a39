//! Ctrl-C and its relatives, as a question that can be asked.

use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};
use signal_hook::flag;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long a signal may stay unnoticed in a pause.
const GLANCE: Duration = Duration::from_millis(50);

/// Whether the process was asked to end.
#[derive(Debug, Clone)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// From now on SIGINT, SIGQUIT, SIGTERM and SIGHUP end nothing, but are noticed.
    pub fn register() -> Self {
        let flag = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGQUIT, SIGTERM, SIGHUP] {
            flag::register(signal, Arc::clone(&flag)).expect("each of these can be handled by any process");
        }
        Self(flag)
    }

    /// Whether one of them came.
    pub fn came(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Whether one of them came since this was asked last, so that a second one can cut an orderly end short.
    pub fn came_again(&self) -> bool {
        self.0.swap(false, Ordering::Relaxed)
    }

    /// Sleeps until `deadline`, or until one of them comes.
    pub fn pause_until(&self, deadline: Instant) {
        while !self.came() {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            std::thread::sleep(left.min(GLANCE));
        }
    }
}
