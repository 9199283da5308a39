//! The IMUs of the robot: which sample is published, and whether one is lost.

use super::context::Context;
use super::event::Event;
use super::gravity::{Finding, GravityCheck};
use motord_bus::{Duration, Instant};
use motord_settings::sensor::imu::{ImuSample, ImuSettings, WhenLost};
use motord_shared::ImuState;
use motord_shared::message::{IMU_CONTRADICTIONS_SHIFT, IMU_FRESH, IMU_LOST, IMU_VALID};

/// The knowledge of an IMU's reader, passed to the cycle as a whole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuReading {
    /// The newest sample, in the frame of the body. No sample, while `sequence` is 0.
    pub sample: ImuSample,
    /// Time when it was received.
    pub received: Instant,
    /// Samples received since the start.
    pub sequence: u64,
    /// Samples that the device took and the reader did not receive, modulo 2³².
    pub missing: u32,
    /// Samples rejected, modulo 2³².
    pub rejected: u32,
    /// The device is connected.
    pub is_connected: bool,
    /// The publisher of an external IMU; 0 for none.
    pub publisher: u64,
}

impl Default for ImuReading {
    fn default() -> Self {
        Self {
            sample: ImuSample::LEVEL,
            received: Instant::ZERO,
            sequence: 0,
            missing: 0,
            rejected: 0,
            is_connected: false,
            publisher: 0,
        }
    }
}

/// An IMU.
///
/// ```text
///            a sample
///   lost ────────────────▶ present
///    ▲                        │
///    └────────────────────────┘
///      none for `lost_after`, or the device is disconnected
/// ```
#[derive(Debug)]
struct Imu {
    lost_after: Duration,
    when_lost: WhenLost,
    reading: ImuReading,
    /// The sequence number of the sample that was published last.
    published: u64,
    is_lost: bool,
    gravity: GravityCheck,
}

impl Imu {
    fn new(settings: &ImuSettings) -> Self {
        Self {
            lost_after: settings.lost_after,
            when_lost: settings.when_lost,
            reading: ImuReading::default(),
            published: 0,
            is_lost: true,
            gravity: GravityCheck::new(settings.mount),
        }
    }

    /// Takes what its reader knows. Returns what a rest showed, if the contradictions change.
    /// Constant time.
    fn receive(&mut self, reading: &ImuReading) -> Option<Finding> {
        let is_new = reading.sequence != self.reading.sequence;
        self.reading = *reading;
        is_new.then(|| self.gravity.receive(&reading.sample, reading.received)).flatten()
    }

    /// Finds out at `tick` whether it is lost. Returns whether that has changed.
    fn check_loss(&mut self, tick: Instant) -> bool {
        let ImuReading { received, sequence, is_connected, .. } = self.reading;
        let is_lost = !is_connected || sequence == 0 || tick.since(received) > self.lost_after;
        core::mem::replace(&mut self.is_lost, is_lost) != is_lost
    }

    const fn forbids_motion(&self) -> bool {
        self.is_lost && matches!(self.when_lost, WhenLost::Stop)
    }

    fn report(&self) -> ImuState {
        let ImuReading { sample, received, sequence, missing, rejected, publisher, .. } = self.reading;
        let lost = if self.is_lost { IMU_LOST } else { 0 };
        let contradictions = self.gravity.contradictions() << IMU_CONTRADICTIONS_SHIFT;
        if sequence == 0 {
            return ImuState { missing, rejected, flags: lost, publisher, ..ImuState::UNKNOWN };
        }
        let fresh = if sequence == self.published { 0 } else { IMU_FRESH };
        ImuState {
            orientation: sample.orientation,
            angular_velocity: sample.angular_velocity,
            acceleration: sample.acceleration,
            temperature: sample.temperature.unwrap_or(f32::NAN),
            flags: lost | fresh | IMU_VALID | contradictions,
            missing,
            rejected,
            sequence,
            receive_ns: received.as_nanos(),
            publisher,
        }
    }
}

/// The IMUs of the robot, in the order of the configuration.
#[derive(Debug)]
pub(super) struct Imus(Vec<Imu>);

impl Imus {
    pub(super) fn new(settings: &[ImuSettings]) -> Self {
        Self(settings.iter().map(Imu::new).collect())
    }

    /// Takes what the reader of an IMU knows. Constant time.
    pub(super) fn receive(&mut self, index: usize, reading: &ImuReading, cx: &mut Context) {
        if let Some(imu) = self.0.get_mut(index) {
            if let Some(Finding { contradictions, up, acceleration }) = imu.receive(reading) {
                cx.push(Event::Gravity { imu: index, contradictions, up, acceleration });
            }
            check_loss(index, imu, cx);
        }
    }

    /// Finds out which IMUs are lost, and reports each change. Bounded by IMUs.
    pub(super) fn watch(&mut self, cx: &mut Context) {
        self.0.iter_mut().enumerate().for_each(|(index, imu)| check_loss(index, imu, cx));
    }

    /// Reports the IMUs that have never delivered a sample. Bounded by IMUs.
    pub(super) fn report_silence(&self, cx: &mut Context) {
        let silent = self.0.iter().enumerate().filter(|(_, imu)| imu.reading.sequence == 0);
        silent.for_each(|(sensor, _)| cx.push(Event::Sensor { sensor, is_lost: true }));
    }

    /// Returns whether an IMU is lost without which the robot must not move.
    pub(super) fn forbid_motion(&self) -> bool {
        self.0.iter().any(Imu::forbids_motion)
    }

    pub(super) fn states(&self) -> impl Iterator<Item = ImuState> + '_ {
        self.0.iter().map(Imu::report)
    }

    /// Records that the samples of this cycle are published and no longer fresh. Bounded by IMUs.
    pub(super) fn published(&mut self) {
        self.0.iter_mut().for_each(|imu| imu.published = imu.reading.sequence);
    }
}

/// Checks by the tick of the cycle, not by its beginning: the samples that arrive while a cycle is
/// late are taken at its end.
fn check_loss(index: usize, imu: &mut Imu, cx: &mut Context) {
    if imu.check_loss(cx.wake.scheduled) {
        cx.push(Event::Sensor { sensor: index, is_lost: imu.is_lost });
    }
}
