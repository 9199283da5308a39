//! When a motor is asked for its faults.

use crate::control::context::Context;
use motord_bus::{Duration, Instant};
use motord_protocol::Faults;

/// The faults of a motor, and when it is asked for them.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct FaultWatch {
    /// The faults that it reported last.
    pub(super) reported: Faults,
    /// When it should be asked next.
    pub(super) poll_at: Instant,
    /// The motor refused a command, reports a fault without its name, or its answer was ambiguous:
    /// it is asked in the next turn.
    pub(super) is_urgent: bool,
    /// Its last state reports a fault without its name.
    pub(super) is_unnamed: bool,
    /// It answered a question for its faults since the first such state.
    pub(super) is_answered: bool,
}

impl FaultWatch {
    /// Sets the time of the next question, after an answer at `at`. The time only rises.
    pub(super) fn postpone(&mut self, at: Instant, cx: &Context) {
        let next = at + Duration::from_secs_f64(1.0 / cx.safety.fault_poll_hz.max(0.01));
        self.poll_at = self.poll_at.max(next);
    }
}
