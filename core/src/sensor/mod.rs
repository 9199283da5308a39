//! The sensors of a CAN bus: their frames in the batch of a cycle, and their readings.
//!
//! The cycle sends and receives the frames of a [`Sensor`], and passes its [`Reading`]s to control.
//! It knows no kind of sensor: each kind is a module here, and a row of [`KINDS`].
//!
//! Real-time: after [`Sensors::new`] nothing here allocates, blocks or calls the system.

mod device;
mod imu;

use crate::control::Reading;
use device::Sensor;
use motord_bus::{Frame, Instant};
use motord_settings::settings::Settings;

/// Returns the sensors of one kind on the CAN bus with this index. Allocates.
type OnBus = fn(&Settings, usize) -> Vec<Box<dyn Sensor>>;

/// The kinds of sensors on CAN buses. A frame of two sensors belongs to that of the first kind.
const KINDS: [OnBus; 1] = [imu::on_bus];

/// The sensors of one bus; of most buses none.
#[derive(Default)]
pub(crate) struct Sensors {
    sensors: Vec<Box<dyn Sensor>>,
    /// By sensor, its frames in the batch.
    frames: Vec<usize>,
    /// The sum of `frames` when they were queued.
    queued: usize,
    has_readings: bool,
}

impl Sensors {
    /// Returns those of the CAN bus with this index. Allocates; nothing after it does.
    pub(crate) fn new(settings: &Settings, bus: usize) -> Self {
        let sensors: Vec<_> = KINDS.iter().flat_map(|on_bus| on_bus(settings, bus)).collect();
        Self { frames: vec![0; sensors.len()], sensors, queued: 0, has_readings: false }
    }

    /// Returns whether the bus has none.
    #[inline]
    pub(crate) const fn is_empty(&self) -> bool {
        self.sensors.is_empty()
    }

    /// Returns the most frames to them in a batch.
    pub(crate) fn frames_max(&self) -> usize {
        self.sensors.iter().map(|sensor| sensor.frames_max()).sum()
    }

    /// Begins a batch without a frame to them.
    #[inline]
    pub(crate) const fn clear(&mut self) {
        self.queued = 0;
    }

    /// Writes the requests of the cycle with this number into the first entries of `frames`.
    /// Bounded by sensors.
    pub(crate) fn queue(&mut self, cycle: u64, now: Instant, frames: &mut [Frame]) {
        let mut free = frames.iter_mut();
        for (sensor, queued) in self.sensors.iter_mut().zip(&mut self.frames) {
            let requests = sensor.requests(cycle, now).iter().zip(&mut free);
            *queued = requests.map(|(frame, entry)| *entry = *frame).count();
        }
        self.has_readings = true;
        self.queued = self.frames.iter().sum();
    }

    /// Returns the number of frames to them in the batch.
    #[inline]
    pub(crate) const fn queued(&self) -> usize {
        self.queued
    }

    /// Records that the bus accepted the first `frames` of the batch's frames to them. Bounded by
    /// sensors.
    pub(crate) fn accepted(&mut self, mut frames: usize) {
        for (sensor, queued) in self.sensors.iter_mut().zip(&mut self.frames) {
            let accepted = frames.min(core::mem::take(queued));
            frames -= accepted;
            sensor.accepted(accepted);
        }
    }

    /// Returns the number of requests of the batch whose replies may arrive. Replies to earlier
    /// batches are not awaited.
    pub(crate) fn open(&self) -> usize {
        if self.queued == 0 { 0 } else { self.sensors.iter().map(|sensor| sensor.open()).sum() }
    }

    /// Takes a frame that is from no motor. `None` when it is not from a sensor; otherwise whether
    /// it is a reply that the batch awaits. Bounded by sensors.
    pub(crate) fn receive(&mut self, frame: &Frame, at: Instant) -> Option<bool> {
        let is_answer = self.sensors.iter_mut().find_map(|sensor| sensor.receive(frame, at))?;
        self.has_readings = true;
        Some(is_answer && self.queued > 0)
    }

    /// Records that the bus is off or its interface is gone.
    #[cold]
    pub(crate) fn disconnect(&mut self) {
        self.sensors.iter_mut().for_each(|sensor| sensor.disconnect());
        self.has_readings = true;
    }

    /// Records that the bus can receive frames. Bounded by sensors.
    pub(crate) fn reconnect(&mut self) {
        self.sensors.iter_mut().for_each(|sensor| sensor.reconnect());
    }

    /// Passes on each reading that has changed since the last call. Bounded by sensors.
    #[inline]
    pub(crate) fn take_readings(&mut self, mut pass: impl FnMut(Reading<'_>)) {
        if core::mem::replace(&mut self.has_readings, false) {
            self.sensors.iter_mut().filter_map(|sensor| sensor.take_reading()).for_each(&mut pass);
        }
    }
}
