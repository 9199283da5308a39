//! Simulated IMUs: one thread gives the samples of all of them.

use super::writer::Writer;
use motord_bus::{Clock as _, Duration, Instant, Monotonic};
use motord_core::imu::{ImuSettings, ImuSimulation};
use motord_simulator::{FaultVerb, Imu, ImuOutput, ImuValues, InjectError};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use triple_buffer::Output;

/// Longest sleep, so that the thread sees that the daemon ends.
const TURN: Duration = Duration::from_millis(50);

/// A simulated IMU and its next sample.
pub(super) struct Source {
    name: String,
    device: Imu,
    writer: Writer,
    period: Duration,
    due: Instant,
    /// Measurements of a plant, and their times. The oldest is the newest that has arrived.
    measured: VecDeque<(Instant, ImuValues)>,
}

/// The body that simulated IMUs measure.
pub enum World {
    /// It moves by itself.
    BuiltIn,
    /// A plant without an IMU: no sample arrives.
    Blind,
    /// That of a plant.
    Body(Output<ImuValues>),
}

impl Source {
    pub(super) fn new(imu: &ImuSettings, errors: &ImuSimulation, writer: Writer, start: Instant) -> Self {
        Self {
            name: imu.name.clone(),
            device: Imu::new(errors.noise, errors.bias, errors.delay, errors.seed),
            writer,
            period: Duration::from_secs_f64(1.0 / imu.rate_hz),
            due: start,
            measured: VecDeque::new(),
        }
    }

    /// Passes the sample that is due.
    fn deliver(&mut self, start: Instant, now: Instant, world: &mut World) {
        let output = match world {
            World::BuiltIn => self.device.sample(self.due.since(start)),
            World::Blind => ImuOutput::Nothing,
            World::Body(body) => match self.measure(now, *body.read()) {
                Some(values) => self.device.sample_of(&values),
                None => ImuOutput::Nothing,
            },
        };
        match output {
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

    /// Returns what was measured the device's delay ago.
    fn measure(&mut self, now: Instant, values: ImuValues) -> Option<ImuValues> {
        self.measured.push_back((now, values));
        let arrives = |(at, _): &(Instant, ImuValues)| *at + self.device.delay() <= now;
        let arrived = self.measured.iter().take_while(|measured| arrives(measured)).count();
        self.measured.drain(..arrived.saturating_sub(1));
        self.measured.front().filter(|_| arrived > 0).map(|(_, values)| *values)
    }
}

/// The simulated IMUs of a daemon. Clones share them.
#[derive(Clone)]
pub struct SimulatedImus(Arc<Mutex<(Vec<Source>, World)>>);

impl SimulatedImus {
    pub(super) fn new(sources: Vec<Source>, world: World) -> Self {
        Self(Arc::new(Mutex::new((sources, world))))
    }

    /// Gives an IMU a fault. `None` when none of them has this name.
    pub fn inject(&self, verb: &FaultVerb) -> Option<Result<(), InjectError>> {
        let (sources, _) = &mut *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let source = sources.iter_mut().find(|source| source.name == verb.target)?;
        Some(source.device.inject(verb.fault))
    }

    /// Passes the samples that are due at `now`. Returns the time of the next one.
    fn deliver(&self, start: Instant, now: Instant) -> Instant {
        let (sources, world) = &mut *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let due = sources.iter_mut().filter(|source| source.due <= now);
        due.for_each(|source| source.deliver(start, now, world));
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
