//! The clock of a robot, which moves only when the cycle sleeps or waits.

use motord_bus::{Clock, Duration, Instant, Readiness, Ready};
use std::sync::{Arc, Mutex};

/// A value that a test shares with the cycle.
#[derive(Debug, Clone, Default)]
pub struct Shared<T>(Arc<Mutex<T>>);

impl<T: Copy + Default> Shared<T> {
    /// Shares `value`.
    pub fn new(value: T) -> Self {
        Self(Arc::new(Mutex::new(value)))
    }

    /// Returns the value.
    pub fn get(&self) -> T {
        *self.0.lock().expect("no thread panics while it holds the lock")
    }

    /// Replaces the value.
    pub fn set(&self, value: T) {
        *self.0.lock().expect("no thread panics while it holds the lock") = value;
    }

    /// Returns the value and leaves the default.
    pub fn take(&self) -> T {
        std::mem::take(&mut self.0.lock().expect("no thread panics while it holds the lock"))
    }
}

/// Virtual time.
#[derive(Debug, Clone)]
pub struct Virtual {
    /// The time.
    pub now: Shared<Instant>,
    /// Time that each reading of the clock takes.
    pub reading: Shared<Duration>,
    /// Number of times that the cycle slept or waited for buses.
    pub waits: Shared<u32>,
    /// Delay of the next wake-up.
    pub late: Shared<Duration>,
    /// Earliest end of the next sleep.
    pub wakes_at: Shared<Option<Instant>>,
    /// Delay of every wake-up.
    pub always_late: Shared<Duration>,
    /// Total time that the computer was suspended.
    pub suspended: Shared<Duration>,
    /// Makes the next reading of the clock panic.
    pub broken: Shared<bool>,
    /// Freezes the process for this duration after this many further readings of the clock.
    pub freeze: Shared<Option<(u32, Duration)>>,
}

impl Clock for Virtual {
    fn now(&self) -> Instant {
        assert!(!self.broken.take(), "a panic in the cycle that the test requested");
        let frozen = match self.freeze.take() {
            Some((0, frozen)) => frozen,
            later => {
                self.freeze.set(later.map(|(readings, frozen)| (readings - 1, frozen)));
                Duration::ZERO
            }
        };
        self.now.set(self.now.get() + self.reading.get() + frozen);
        self.now.get()
    }

    fn now_and_suspended(&self) -> (Instant, Duration) {
        (self.now(), self.suspended.get())
    }

    fn sleep_until(&mut self, instant: Instant) {
        self.waits.set(self.waits.get() + 1);
        let end = self.wakes_at.take().unwrap_or(instant).max(instant);
        self.now.set(self.now.get().max(end + self.late.take() + self.always_late.get()));
    }

    fn wait(&mut self, readiness: &[Readiness<'_>], until: Instant) -> Ready {
        self.waits.set(self.waits.get() + 1);
        let wake = readiness.iter().fold(until, |wake, readiness| match *readiness {
            Readiness::At(at) => wake.min(at),
            _ => wake,
        });
        self.now.set(self.now.get().max(wake));
        let now = self.now.get();
        Ready::of(readiness.iter().map(|readiness| matches!(*readiness, Readiness::At(at) if at <= now)))
    }
}
