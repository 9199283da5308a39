//! A sensor on a CAN bus, as the cycle uses it.

use crate::control::Reading;
use motord_bus::{Frame, Instant};

/// A sensor on a CAN bus. No function allocates, blocks or calls the system; each takes constant
/// time.
pub(super) trait Sensor: Send {
    /// Returns the most frames that are sent to it in a cycle.
    fn frames_max(&self) -> usize;

    /// Returns the frames to it in the cycle with this number, which are sent at `now`.
    fn requests(&mut self, cycle: u64, now: Instant) -> &[Frame];

    /// Records that the bus accepted this number of the frames of this cycle. The replies to the
    /// others are not awaited.
    fn accepted(&mut self, frames: usize);

    /// Returns the number of requests whose replies may arrive.
    fn open(&self) -> usize;

    /// Takes a frame of the bus that arrived at `at`. `None` when it is not from this sensor;
    /// otherwise whether it is the reply to an open request.
    fn receive(&mut self, frame: &Frame, at: Instant) -> Option<bool>;

    /// Records that the bus is off or its interface is gone: the sensor is disconnected.
    fn disconnect(&mut self);

    /// Records that the bus can receive frames.
    fn reconnect(&mut self);

    /// Returns the reading, if it has changed since the last call.
    fn take_reading(&mut self) -> Option<Reading<'_>>;
}
