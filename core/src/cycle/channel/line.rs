//! A line in the cycle: read when a cycle begins, and written to after the CAN buses.

use super::wire::Wire;
use crate::stopper::LineRound;
use motord_bus::{Frame, Instant, Refusal};

/// A line: a bus with one open request at a time.
pub(crate) struct LineChannel {
    pub(super) wire: Wire,
    round: LineRound,
}

impl LineChannel {
    pub(super) fn new(wire: Wire) -> Self {
        Self { wire, round: LineRound::default() }
    }

    pub(super) fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal> {
        let Self { wire, round } = self;
        round.send(frames, |frame| wire.send_unanswered(now, frame))
    }
}
