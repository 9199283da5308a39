//! Safe frames: encoded at the start from the settings, and sent without them.

use crate::drive::safe_frames;
use motord_bus::{Frame, Refusal};
use motord_settings::settings::Settings;

/// The safe frames of one bus.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct BusFrames {
    /// One frame per motor that damps it, twice: rounds send the two in turn, so that their
    /// rounding errors cancel. For a GIM motor both are the frame that stops it: one that brakes it
    /// would be full torque to a motor in MIT mode.
    pub damp: [Vec<Frame>; 2],
    /// One frame per motor that stops it.
    pub stop: Vec<Frame>,
}

impl BusFrames {
    /// Returns the safe frames of the motors on the bus with this index. Allocates.
    #[must_use]
    pub fn of(settings: &Settings, bus: usize) -> Self {
        let motors = settings.motors.iter().filter(|motor| motor.bus == bus);
        let (damp, stop): (Vec<_>, _) = motors.filter_map(safe_frames).unzip();
        Self { damp: [0, 1].map(|turn| damp.iter().map(|frames| frames[turn]).collect()), stop }
    }

    /// Returns the number of frames in the largest round.
    #[must_use]
    pub fn most(&self) -> usize {
        self.damp.iter().chain([&self.stop]).map(Vec::len).max().unwrap_or(0)
    }

    /// Returns whether `frame` is one of them. Does not allocate; bounded by their number.
    #[must_use]
    pub fn contains(&self, frame: &Frame) -> bool {
        self.damp.iter().chain([&self.stop]).any(|frames| frames.contains(frame))
    }
}

/// A round on a serial line, which carries one request at a time. Each call sends the frame of one
/// motor. The round is complete after the frame of the last motor.
#[derive(Debug, Clone, Copy, Default)]
pub struct LineRound {
    next: usize,
}

impl LineRound {
    /// Sends the next frame by `send`, which returns the reason of a refusal. Returns the reason
    /// why the round is not complete. Does not allocate or block, if `send` does not.
    pub fn send(
        &mut self,
        frames: &[Frame],
        send: impl FnOnce(&[Frame]) -> Option<Refusal>,
    ) -> Option<Refusal> {
        if self.next >= frames.len() {
            self.next = 0;
        }
        let refusal = send(frames.get(self.next..=self.next).unwrap_or_default());
        if refusal.is_none() {
            self.next += 1;
        }
        let is_taken = self.next >= frames.len();
        refusal.or((!is_taken).then_some(Refusal::Full))
    }
}
