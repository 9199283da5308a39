//! The clock that a link waits by.

use motord_bus::{Duration, Instant, Readiness};

/// Time, and waiting for a bus.
pub trait Timer: Send {
    /// The present time.
    fn now(&self) -> Instant;

    /// Returns when the bus of `readiness` has something, or at `until`. May return early.
    fn wait(&mut self, readiness: Readiness<'_>, until: Instant);
}

/// Virtual time, for simulated buses: it moves when somebody waits, and not else.
#[derive(Debug, Clone)]
pub struct VirtualTime(Instant);

impl VirtualTime {
    /// The least step of a wait, so that a bus which is always ready does not stop the time.
    const STEP: Duration = Duration::from_micros(1);

    /// A clock that shows `start`.
    #[must_use]
    pub const fn new(start: Instant) -> Self {
        Self(start)
    }
}

impl Timer for VirtualTime {
    fn now(&self) -> Instant {
        self.0
    }

    fn wait(&mut self, readiness: Readiness<'_>, until: Instant) {
        let ready = match readiness {
            Readiness::At(at) => at.max(self.0 + Self::STEP),
            Readiness::Readable(_) | Readiness::Never => until,
        };
        self.0 = self.0.max(ready.min(until));
    }
}

/// The clock of this machine.
#[cfg(feature = "linux")]
#[derive(Debug, Clone, Copy, Default)]
pub struct MachineTime;

#[cfg(feature = "linux")]
impl Timer for MachineTime {
    fn now(&self) -> Instant {
        motord_bus::clock::monotonic()
    }

    fn wait(&mut self, readiness: Readiness<'_>, until: Instant) {
        let _ready = motord_bus::wait(&[readiness], self.now(), until);
    }
}
