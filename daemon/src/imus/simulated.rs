//! Simulated IMUs: one thread gives the samples of all of them.

use super::reader::{Reader, TURN};
use super::writer::Writer;
use motord_bus::{Clock as _, Duration, Instant, Monotonic};
use motord_protocol::imu::SerialProtocol;
use motord_settings::sensor::imu::{ImuSettings, ImuSimulation, ImuSource};
use motord_simulator::{FaultVerb, Imu, ImuOutput, ImuPort, ImuValues, ImuVendor, InjectError};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use triple_buffer::Output;

/// A simulated IMU and its next sample. With a plant, the IMU measures the body at the due time;
/// the sample arrives a delay later.
pub(super) struct Source {
    name: String,
    device: Imu,
    writer: Writer,
    period: Duration,
    due: Instant,
    /// Samples of a plant that have not arrived, and when they do.
    in_flight: VecDeque<(Instant, ImuOutput)>,
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
            in_flight: VecDeque::new(),
        }
    }

    /// Returns when it next measures, or when its next sample arrives.
    fn next(&self) -> Instant {
        self.in_flight.front().map_or(self.due, |(arrives, _)| self.due.min(*arrives))
    }

    /// Takes the sample that is due, and passes those that have arrived.
    fn deliver(&mut self, start: Instant, now: Instant, world: &mut World) {
        if self.due <= now {
            let output = match world {
                World::BuiltIn => Some(self.device.sample(self.due.since(start))),
                World::Blind => Some(ImuOutput::Nothing),
                World::Body(body) => {
                    let output = self.device.sample_of(body.read());
                    self.in_flight.push_back((self.due + self.device.delay(), output));
                    None
                }
            };
            output.iter().for_each(|output| self.pass(output, now));
            self.due = self.due + self.period;
            // After a stall the samples in between are lost.
            while self.due < now {
                self.writer.missed(1);
                self.due = self.due + self.period;
            }
        }
        while let Some((_, output)) = self.in_flight.pop_front_if(|(arrives, _)| *arrives <= now) {
            self.pass(&output, now);
        }
    }

    fn pass(&mut self, output: &ImuOutput, now: Instant) {
        match output {
            ImuOutput::Sample(values) => {
                let _counted = self.writer.sample(&motord_twin::sample(values), now);
            }
            ImuOutput::Nothing => self.writer.missed(1),
            ImuOutput::Gone => self.writer.disconnected(),
        }
    }
}

/// The simulated IMUs of a daemon. Clones share them.
#[derive(Clone)]
pub struct SimulatedImus {
    start: Instant,
    sources: Arc<Mutex<(Vec<Source>, World)>>,
}

impl SimulatedImus {
    pub(super) fn new(sources: Vec<Source>, world: World, start: Instant) -> Self {
        Self { start, sources: Arc::new(Mutex::new((sources, world))) }
    }

    /// Gives an IMU a fault. `None` when none of them has this name.
    pub fn inject(&self, verb: &FaultVerb) -> Option<Result<(), InjectError>> {
        let (sources, _) = &mut *self.sources.lock().unwrap_or_else(PoisonError::into_inner);
        let source = sources.iter_mut().find(|source| source.name == verb.target)?;
        Some(source.device.inject(verb.fault))
    }

    /// Passes the samples that are due at `now`. Returns the time of the next one.
    fn deliver(&self, now: Instant) -> Instant {
        let (sources, world) = &mut *self.sources.lock().unwrap_or_else(PoisonError::into_inner);
        let due = sources.iter_mut().filter(|source| source.next() <= now);
        due.for_each(|source| source.deliver(self.start, now, world));
        sources.iter().map(Source::next).min().unwrap_or(now + TURN)
    }
}

impl Reader for SimulatedImus {
    fn thread(&self) -> &'static str {
        "imus"
    }

    fn turn(&mut self) {
        let mut clock = Monotonic;
        let now = clock.now();
        let next = self.deliver(now);
        clock.sleep_until(next.min(now + TURN));
    }
}

/// Standard deviation of each axis of the angular velocity, rad/s.
const NOISE: f64 = 0.002;

/// Opens a pseudo terminal for an IMU on a serial line, with `link` to it; `None` for another IMU.
///
/// # Errors
///
/// The kernel provides no pseudo terminal, or the link cannot be created.
pub fn simulated_port(
    imu: &ImuSettings,
    start: Instant,
    link: Option<PathBuf>,
    seed: u64,
) -> Option<Result<ImuPort, std::io::Error>> {
    let ImuSource::Serial(line) = &imu.source else { return None };
    let vendor = match line.protocol {
        SerialProtocol::Hipnuc => ImuVendor::Hipnuc,
        SerialProtocol::Xsens => ImuVendor::Xsens,
    };
    let device = Imu::new(NOISE, 0.0, Duration::ZERO, seed);
    Some(ImuPort::open(imu.name.clone(), (device, vendor), (imu.rate_hz, line.baud), start, link))
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_core::control::ImuReading;
    use motord_settings::sensor::imu::Mount;
    use triple_buffer::{Input, TripleBuffer};

    const LEVEL: ImuValues = ImuValues {
        orientation: [1.0, 0.0, 0.0, 0.0],
        angular_velocity: [0.0; 3],
        acceleration: [0.0, 0.0, 9.81],
        temperature: 25.0,
    };

    /// An IMU of 200 Hz without errors on the body of a plant.
    fn imu(delay: Duration) -> (SimulatedImus, Input<ImuValues>, Output<ImuReading>) {
        let (body, measured) = TripleBuffer::new(&LEVEL).split();
        let (input, read) = TripleBuffer::new(&ImuReading::default()).split();
        let source = Source {
            name: "base".into(),
            device: Imu::new(0.0, 0.0, delay, 0),
            writer: Writer::new(input, Mount::ALIGNED),
            period: Duration::from_millis(5),
            due: Instant::ZERO,
            in_flight: VecDeque::new(),
        };
        (SimulatedImus::new(vec![source], World::Body(measured), Instant::ZERO), body, read)
    }

    /// Also when the delay is no multiple of the period, and when the thread wakes up late.
    #[test]
    fn plant_sample_is_as_old_as_its_delay() {
        for (delay, late) in [(2, 0), (2, 80), (5, 80), (12, 80)] {
            let delay = Duration::from_millis(delay);
            let (imus, mut body, mut read) = imu(delay);
            let (mut now, mut sequence) = (Instant::ZERO, 0);
            while now < Instant::from_nanos(200_000_000) {
                // The body turns by 1 rad/s faster each second.
                let seconds = now.since(Instant::ZERO).as_secs_f64();
                body.write(ImuValues { angular_velocity: [seconds, 0.0, 0.0], ..LEVEL });
                let next = imus.deliver(now);
                let reading = read.read();
                if reading.sequence > sequence {
                    sequence = reading.sequence;
                    let age = seconds - f64::from(reading.sample.angular_velocity[0]);
                    assert!((age - delay.as_secs_f64()).abs() < 150e-6, "{delay:?}: {age} s");
                }
                now = next + Duration::from_micros(late * (1 + now.as_nanos() % 2));
            }
            assert!(sequence > 36, "{delay:?}: {sequence}");
            assert_eq!(read.read().missing, 0);
        }
    }
}
