//! The IMUs of the robot: which sample is published, and whether one is lost.

use super::Control;
use super::event::Event;
use crate::imu::{ImuSample, ImuSettings, WhenLost};
use motord_bus::{Duration, Instant};
use motord_shared::message::{IMU_FRESH, IMU_LOST, IMU_VALID};
use motord_shared::{Cause, ImuState};

/// What the reader of an IMU knows, passed to the cycle as a whole.
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
pub(super) struct Imu {
    lost_after: Duration,
    when_lost: WhenLost,
    reading: ImuReading,
    /// The sequence number of the sample that was published last.
    published: u64,
    is_lost: bool,
}

impl Imu {
    pub(super) fn new(settings: &ImuSettings) -> Self {
        Self {
            lost_after: settings.lost_after,
            when_lost: settings.when_lost,
            reading: ImuReading::default(),
            published: 0,
            is_lost: true,
        }
    }

    /// Finds out at `now` whether it is lost. Returns whether that has changed.
    fn judge(&mut self, now: Instant) -> bool {
        let ImuReading { received, sequence, is_connected, .. } = self.reading;
        let is_lost = !is_connected || sequence == 0 || now.since(received) > self.lost_after;
        core::mem::replace(&mut self.is_lost, is_lost) != is_lost
    }

    const fn forbids_motion(&self) -> bool {
        self.is_lost && matches!(self.when_lost, WhenLost::Stop)
    }

    fn report(&self) -> ImuState {
        let ImuReading { sample, received, sequence, missing, rejected, .. } = self.reading;
        let lost = if self.is_lost { IMU_LOST } else { 0 };
        if sequence == 0 {
            return ImuState { missing, rejected, flags: lost, ..ImuState::UNKNOWN };
        }
        let fresh = if sequence == self.published { 0 } else { IMU_FRESH };
        ImuState {
            orientation: sample.orientation,
            angular_velocity: sample.angular_velocity,
            acceleration: sample.acceleration,
            temperature: sample.temperature.unwrap_or(f32::NAN),
            flags: lost | fresh | IMU_VALID,
            missing,
            rejected,
            sequence,
            receive_ns: received.as_nanos(),
        }
    }
}

impl Control {
    /// Takes what the reader of an IMU knows. Constant time.
    pub fn receive_imu(&mut self, imu: usize, reading: &ImuReading) {
        if let Some(known) = self.imus.get_mut(imu) {
            known.reading = *reading;
            self.judge_imu(imu);
        }
    }

    /// Returns the state of every IMU after this cycle, in the order of the configuration.
    pub fn imu_states(&self) -> impl Iterator<Item = ImuState> + '_ {
        self.imus.iter().map(Imu::report)
    }

    /// Stops every moving group while an IMU is lost for which it is configured. Reports each change. Bounded by IMUs and
    /// motors.
    pub(super) fn watch_imus(&mut self) {
        (0..self.imus.len()).for_each(|imu| self.judge_imu(imu));
        if self.an_imu_forbids_motion() {
            self.stop_moving(Cause::ImuLost);
        }
    }

    fn judge_imu(&mut self, index: usize) {
        let Self { imus, context, .. } = self;
        let imu = &mut imus[index];
        if imu.judge(context.now) {
            context.push(Event::Imu { imu: index, is_lost: imu.is_lost });
        }
    }

    /// Reports the IMUs that have never delivered a sample. Bounded by IMUs.
    pub(super) fn report_silent_imus(&mut self) {
        let Self { imus, context, .. } = self;
        let silent = imus.iter().enumerate().filter(|(_, imu)| imu.reading.sequence == 0);
        silent.for_each(|(imu, _)| context.push(Event::Imu { imu, is_lost: true }));
    }

    pub(super) fn an_imu_forbids_motion(&self) -> bool {
        self.imus.iter().any(Imu::forbids_motion)
    }

    /// Records that the samples of this cycle are published and no longer fresh. Bounded by IMUs.
    pub(super) fn imus_published(&mut self) {
        self.imus.iter_mut().for_each(|imu| imu.published = imu.reading.sequence);
    }
}
