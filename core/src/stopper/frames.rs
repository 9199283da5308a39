//! Safe frames: made beforehand, while the settings of the motors are known, and sent without that knowledge.

use crate::drive::safe_frames;
use crate::settings::Settings;
use motord_bus::Frame;

/// The safe frames of one bus.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct BusFrames {
    /// One frame per motor that damps it. For a native motor it is the frame that stops it: damping takes the last
    /// state of the motor, which is not known any more.
    pub damp: Vec<Frame>,
    /// One frame per motor that stops it.
    pub stop: Vec<Frame>,
}

impl BusFrames {
    /// The safe frames of the motors on the bus with this index. Allocates.
    #[must_use]
    pub fn of(settings: &Settings, bus: usize) -> Self {
        let motors = settings.motors.iter().filter(|motor| motor.bus == bus);
        let (damp, stop) = motors.filter_map(safe_frames).unzip();
        Self { damp, stop }
    }
}
