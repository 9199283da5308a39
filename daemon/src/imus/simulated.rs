//! Simulated IMUs: one thread gives the samples of all of them.

use super::Writer;
use motord_bus::{Clock as _, Duration, Instant, Monotonic};
use motord_core::control::ImuReading;
use motord_core::imu::{ImuSample, ImuSettings, ImuSource};
use motord_simulator::{FaultVerb, Imu, ImuOutput, InjectError};
use std::sync::{Arc, Mutex, PoisonError};
use triple_buffer::Input;

/// Longest sleep, so that the thread sees that the daemon ends.
const TURN: Duration = Duration::from_millis(50);

/// A simulated IMU and its next sample.
struct Source {
    name: String,
    device: Imu,
    writer: Writer,
    period: Duration,
    due: Instant,
}

impl Source {
    /// Passes the sample that is due.
    fn deliver(&mut self, start: Instant, now: Instant) {
        match self.device.sample(self.due.since(start)) {
            ImuOutput::Sample(values) => self.writer.sample(&converted(&values), now),
            ImuOutput::Nothing => self.writer.missed(),
            ImuOutput::Gone => self.writer.disconnected(),
        }
        self.due = self.due + self.period;
        // After a stall the samples in between are lost.
        while self.due < now {
            self.writer.missed();
            self.due = self.due + self.period;
        }
    }
}

/// The simulated IMUs of a daemon. Clones share them.
#[derive(Clone)]
pub struct SimulatedImus(Arc<Mutex<Vec<Source>>>);

impl SimulatedImus {
    /// Takes the simulated ones of `imus`, with their ends of the cycle. `None` when there is none.
    #[must_use]
    pub fn of(imus: &[ImuSettings], inputs: Vec<Input<ImuReading>>, start: Instant) -> Option<Self> {
        let sources: Vec<_> =
            imus.iter().zip(inputs).filter_map(|(imu, input)| source(imu, input, start)).collect();
        (!sources.is_empty()).then(|| Self(Arc::new(Mutex::new(sources))))
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

/// `None` for a device.
fn source(settings: &ImuSettings, input: Input<ImuReading>, start: Instant) -> Option<Source> {
    let ImuSource::Simulated(errors) = &settings.source else { return None };
    Some(Source {
        name: settings.name.clone(),
        device: Imu::new(errors.noise, errors.bias, errors.delay, errors.seed),
        writer: Writer::new(input, settings.mount),
        period: Duration::from_secs_f64(1.0 / settings.rate_hz),
        due: start,
    })
}

fn converted(values: &motord_simulator::ImuValues) -> ImuSample {
    ImuSample {
        orientation: values.orientation.map(|value| value as f32),
        angular_velocity: values.angular_velocity.map(|value| value as f32),
        acceleration: values.acceleration.map(|value| value as f32),
        temperature: Some(values.temperature as f32),
    }
}
