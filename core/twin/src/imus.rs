//! The IMUs of a twin: what the body does, as its sensors report it.

use motord_bus::{Duration, Instant};
use motord_core::control::ImuReading;
use motord_settings::sensor::imu::{ImuSample, ImuSettings, ImuSimulation, ImuSource};
use motord_simulator::{FaultVerb, Imu, ImuOutput, ImuValues, InjectError};
use std::collections::VecDeque;

/// The body on which the IMUs are.
pub trait Body: Send {
    /// Returns what a perfect sensor measures now, in the frame of the body: x forward, y left, z
    /// up.
    fn measure(&mut self) -> ImuValues;
}

/// One IMU.
pub(crate) struct Sensor {
    name: String,
    device: Imu,
    period: Duration,
    /// Time of the next measurement.
    due: Instant,
    /// Measurements that have not arrived, and when they do.
    in_flight: VecDeque<(Instant, ImuOutput)>,
    reading: ImuReading,
}

impl Sensor {
    pub(crate) fn new(settings: &ImuSettings, seed: u64, start: Instant) -> Self {
        let errors = match &settings.source {
            ImuSource::Simulated(errors) => errors,
            _ => &ImuSimulation::PERFECT,
        };
        Self {
            name: settings.name.clone(),
            device: Imu::new(errors.noise, errors.bias, errors.delay, errors.seed ^ seed),
            period: Duration::from_secs_f64(1.0 / settings.rate_hz),
            due: start,
            in_flight: VecDeque::new(),
            reading: ImuReading::default(),
        }
    }

    pub(crate) fn is(&self, name: &str) -> bool {
        self.name == name
    }

    /// It measures by `now`.
    pub(crate) fn is_due(&self, now: Instant) -> bool {
        self.due <= now
    }

    /// Gives it a fault, if it has this name.
    pub(crate) fn inject(&mut self, verb: &FaultVerb) -> Option<Result<(), InjectError>> {
        (self.name == verb.target).then(|| self.device.inject(verb.fault))
    }

    /// Measures, if it is time for it. `values` are those of `now`.
    pub(crate) fn measure(&mut self, now: Instant, values: &ImuValues) {
        while self.due <= now {
            let output = self.device.sample_of(values);
            self.in_flight.push_back((self.due + self.device.delay(), output));
            self.due = self.due + self.period;
        }
    }

    /// Returns its reading at `now`, if something arrived.
    pub(crate) fn arrived(&mut self, now: Instant) -> Option<ImuReading> {
        let mut has_arrived = false;
        while let Some((at, output)) = self.in_flight.pop_front_if(|(at, _)| *at <= now) {
            has_arrived = true;
            self.take(at, &output);
        }
        has_arrived.then_some(self.reading)
    }

    fn take(&mut self, at: Instant, output: &ImuOutput) {
        let reading = &mut self.reading;
        match output {
            ImuOutput::Sample(values) => {
                reading.is_connected = true;
                match sample(values).checked() {
                    Some(sample) => {
                        (reading.sample, reading.received) = (sample, at);
                        reading.sequence += 1;
                    }
                    None => reading.rejected = reading.rejected.wrapping_add(1),
                }
            }
            ImuOutput::Nothing => reading.missing = reading.missing.wrapping_add(1),
            ImuOutput::Gone => reading.is_connected = false,
        }
    }
}

/// Converts the values of a simulated IMU.
#[must_use]
pub fn sample(values: &ImuValues) -> ImuSample {
    ImuSample {
        orientation: values.orientation.map(|value| value as f32),
        angular_velocity: values.angular_velocity.map(|value| value as f32),
        acceleration: values.acceleration.map(|value| value as f32),
        temperature: Some(values.temperature as f32),
    }
}
