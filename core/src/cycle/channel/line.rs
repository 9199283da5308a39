//! A line in the cycle: read when a cycle begins, and written to after the CAN buses.

use super::base::ChannelBase;
use crate::stopper::LineRound;
use motord_bus::{Frame, Instant, Refusal};

/// A line: a bus with one open request at a time.
pub(crate) struct LineChannel {
    pub(super) base: ChannelBase,
    round: LineRound,
}

impl LineChannel {
    pub(super) fn new(base: ChannelBase) -> Self {
        Self { base, round: LineRound::default() }
    }

    pub(super) fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal> {
        let Self { base, round } = self;
        round.send(frames, |frame| base.send_unanswered(now, frame))
    }
}
