//! One bus with two users: the daemon uses it, and a test injects faults and reads its motors.

use crate::SimulatedBus;
use motord_bus::{Bus, Frame, Inbox, Instant, Readiness, Sent};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A handle to a simulated bus. Clones refer to the same bus. Its [`Bus`] waits while another clone
/// is locked, so it is only for tests and demonstrations.
#[derive(Debug, Clone)]
pub struct SharedBus(Arc<Mutex<SimulatedBus>>);

impl SharedBus {
    /// Shares `bus`.
    #[must_use]
    pub fn new(bus: SimulatedBus) -> Self {
        Self(Arc::new(Mutex::new(bus)))
    }

    /// Locks the bus until the guard is dropped. A panic while the guard is held does not make the
    /// bus unusable.
    pub fn lock(&self) -> MutexGuard<'_, SimulatedBus> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Bus for SharedBus {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        self.lock().send(now, frames)
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        self.lock().receive(now, inbox);
    }

    fn discard_queue(&mut self) -> bool {
        self.lock().discard_queue()
    }

    fn readiness(&self) -> Readiness<'_> {
        match self.lock().readiness() {
            Readiness::At(instant) => Readiness::At(instant),
            // A simulated bus has no descriptor.
            Readiness::Readable(_) | Readiness::Never => Readiness::Never,
        }
    }
}
