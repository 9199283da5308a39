//! A serial line in the cycle: read when a cycle begins, and written to after the CAN buses.

use super::wire::Wire;
use crate::drive::Received;
use crate::stopper::LineRound;
use motord_bus::{Frame, Instant, Refusal};

/// A serial line.
pub(crate) struct LineChannel {
    pub(super) wire: Wire,
    round: LineRound,
}

impl LineChannel {
    pub(super) fn new(wire: Wire) -> Self {
        Self { wire, round: LineRound::default() }
    }

    /// Reads at most one inbox full, as [`Wire::receive`] does. At most one system call.
    pub(crate) fn receive(
        &mut self,
        now: Instant,
        judge: impl FnMut(usize, Option<&[u8]>, Instant) -> Received,
    ) {
        self.wire.clear_inbox();
        self.wire.receive(now, judge);
    }

    pub(super) fn send_round(&mut self, now: Instant, frames: &[Frame]) -> Option<Refusal> {
        let Self { wire, round } = self;
        round.send(frames, |frame| wire.send_unanswered(now, frame))
    }
}
