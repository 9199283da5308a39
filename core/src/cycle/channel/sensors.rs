//! The IMUs of a CAN bus: their requests in the batch of a cycle, and their frames.

use crate::control::ImuReading;
use crate::drive::ImuDrive;
use motord_bus::{Frame, Instant};
use motord_settings::settings::Settings;

/// The IMUs of one bus; of most buses none.
#[derive(Default)]
pub(crate) struct Sensors {
    imus: Vec<ImuDrive>,
    /// By IMU, its frames in the batch.
    queued: Vec<usize>,
    has_news: bool,
}

impl Sensors {
    /// Returns those of the CAN bus with this index. Allocates; nothing after it does.
    pub(super) fn new(settings: &Settings, bus: usize) -> Self {
        let imus = ImuDrive::on_bus(settings, bus);
        Self { queued: vec![0; imus.len()], imus, has_news: false }
    }

    /// Returns whether the bus has none.
    #[inline]
    pub(crate) const fn is_empty(&self) -> bool {
        self.imus.is_empty()
    }

    /// Returns the most frames to them in a batch.
    pub(super) fn frames_max(&self) -> usize {
        self.imus.iter().map(ImuDrive::requests_max).sum()
    }

    /// Writes the frames of the cycle with this number into the first entries of `frames`. Returns their number. Bounded by IMUs.
    pub(super) fn ask(&mut self, cycle: u64, now: Instant, frames: &mut [Frame]) -> usize {
        let mut free = frames.iter_mut();
        for (imu, queued) in self.imus.iter_mut().zip(&mut self.queued) {
            *queued = imu.ask(cycle, now).iter().zip(&mut free).map(|(frame, entry)| *entry = *frame).count();
        }
        self.has_news = true;
        self.queued.iter().sum()
    }

    /// Records that the bus accepted the first `frames` of them. Returns the number of awaited replies. Bounded by IMUs.
    pub(super) fn accepted(&mut self, mut frames: usize) -> usize {
        for (imu, queued) in self.imus.iter_mut().zip(&mut self.queued) {
            let accepted = frames.min(core::mem::take(queued));
            frames -= accepted;
            imu.accepted(accepted);
        }
        self.open()
    }

    /// Returns the number of requests whose replies may arrive.
    pub(super) fn open(&self) -> usize {
        self.imus.iter().map(ImuDrive::open).sum()
    }

    /// Takes a frame that is from no motor. `None` when it is not from an IMU; otherwise whether it is the reply to an open
    /// request. Bounded by IMUs.
    pub(super) fn receive(&mut self, frame: &Frame, at: Instant) -> Option<bool> {
        let is_answer = self.imus.iter_mut().find_map(|imu| imu.receive(frame, at));
        self.has_news |= is_answer.is_some();
        is_answer
    }

    /// Records that the bus is off or its interface is gone.
    #[cold]
    pub(crate) fn disconnect(&mut self) {
        self.imus.iter_mut().for_each(ImuDrive::disconnect);
        self.has_news = true;
    }

    /// Records that the bus can receive frames. Bounded by IMUs.
    pub(super) fn reconnect(&mut self) {
        self.imus.iter_mut().for_each(ImuDrive::reconnect);
    }

    /// Passes on the knowledge of each IMU that has changed since the last call. Bounded by IMUs.
    #[inline]
    pub(crate) fn take_news(&mut self, mut pass: impl FnMut(usize, &ImuReading)) {
        if core::mem::replace(&mut self.has_news, false) {
            for imu in &mut self.imus {
                if let Some((index, reading)) = imu.news() {
                    pass(index, reading);
                }
            }
        }
    }
}
