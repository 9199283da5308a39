//! Simulated IMUs: one thread gives the samples of all of them.

use super::writer::Writer;
use motord_bus::{Clock as _, Duration, Instant, Monotonic};
use motord_core::imu::{ImuSettings, ImuSimulation};
use motord_simulator::{FaultVerb, Imu, ImuOutput, InjectError};
use std::sync::{Arc, Mutex, PoisonError};

/// Longest sleep, so that the thread sees that the daemon ends.
const TURN: Duration = Duration::from_millis(50);

/// A simulated IMU and its next sample.
pub(super) struct Source {
    name: String,
    device: Imu,
    writer: Writer,
    period: Duration,
    due: Instant,
}

impl Source {
    pub(super) fn new(imu: &ImuSettings, errors: &ImuSimulation, writer: Writer, start: Instant) -> Self {
        Self {
            name: imu.name.clone(),
            device: Imu::new(errors.noise, errors.bias, errors.delay, errors.seed),
            writer,
            period: Duration::from_secs_f64(1.0 / imu.rate_hz),
            due: start,
        }
    }

    /// Passes the sample that is due.
    fn deliver(&mut self, start: Instant, now: Instant) {
        match self.device.sample(self.due.since(start)) {
            ImuOutput::Sample(values) => {
                let _counted = self.writer.sample(&motord_twin::sample(&values), now);
            }
            ImuOutput::Nothing => self.writer.missed(1),
            ImuOutput::Gone => self.writer.disconnected(),
        }
        self.due = self.due + self.period;
        // After a stall the samples in between are lost.
        while self.due < now {
            self.writer.missed(1);
            self.due = self.due + self.period;
        }
    }
}

/// The simulated IMUs of a daemon. Clones share them.
#[derive(Clone)]
pub struct SimulatedImus(Arc<Mutex<Vec<Source>>>);

impl SimulatedImus {
    pub(super) fn new(sources: Vec<Source>) -> Self {
        Self(Arc::new(Mutex::new(sources)))
    }

    /// Gives an IMU a fault. `None` when none of them has this name.
    pub fn inject(&self, verb: &FaultVerb) -> Option<Result<(), InjectError>> {
        let mut sources = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let source = sources.iter_mut().find(|source| source.name == verb.target)?;
        Some(source.device.inject(verb.fault))
    }

    /// Passes the samples that are due at `now`. Returns the time of the next one.
    fn deliver(&self, start: Instant, now: Instant) -> Instant {
        let mut sources = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        sources.iter_mut().filter(|source| source.due <= now).for_each(|source| source.deliver(start, now));
        sources.iter().map(|source| source.due).min().unwrap_or(now + TURN)
    }

    /// Passes samples until `stop` returns true.
    pub fn run(&self, start: Instant, stop: impl Fn() -> bool) {
        let mut clock = Monotonic;
        while !stop() {
            let now = clock.now();
            let next = self.deliver(start, now);
            clock.sleep_until(next.min(now + TURN));
        }
    }
}
