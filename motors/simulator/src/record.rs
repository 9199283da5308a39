//! Frames that were on the wire, for tests that check bytes.

use motord_bus::{Frame, Instant};
use std::collections::VecDeque;

/// A frame that was complete on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Recorded {
    /// The frame has waited for the wire since this time. A frame of the host waits from its send.
    pub ready: Instant,
    /// The end of the frame.
    pub at: Instant,
    /// Its direction.
    pub direction: Direction,
    /// The frame.
    pub frame: Frame,
}

/// The direction of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// From the host.
    ToMotor,
    /// From a motor or a flood.
    ToHost,
}

/// The newest frames; never grows.
#[derive(Debug, Clone)]
pub(crate) struct Record {
    frames: VecDeque<Recorded>,
    capacity: usize,
}

impl Record {
    pub(crate) fn new(capacity: usize) -> Self {
        Self { frames: VecDeque::with_capacity(capacity), capacity }
    }

    pub(crate) fn push(&mut self, recorded: Recorded) {
        if self.capacity == 0 {
            return;
        }
        if self.frames.len() == self.capacity {
            self.frames.pop_front();
        }
        self.frames.push_back(recorded);
    }

    pub(crate) fn take(&mut self) -> impl Iterator<Item = Recorded> + '_ {
        self.frames.drain(..)
    }
}
