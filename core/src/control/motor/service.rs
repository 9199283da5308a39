//! A request of an operator to one stopped motor, whose outcome is known in a later cycle.
//!
//! ```text
//!   SetZero:    send ──▶ wait for a state within 0.01 rad of zero ──▶ done      (MIT document 1.1; protocol note M13)
//!   ClearFault: send ──▶ ask for the fault; send again while      ──▶ done      (MIT document 1.2: the clear reply
//!               the motor reports one                                            has no content)
//!   either:     not confirmed in time ──▶ refused
//! ```

use motord_bus::{Duration, Instant};
use motord_protocol::drive::Command;

/// Setting the zero writes flash: drives of this family are silent for up to 1.5 s.
const ZERO_TIME: Duration = Duration::from_secs(3);
/// Least time between two zeros of a motor. Each is a write to its flash, which endures some ten
/// thousand of them; a program in a loop would reach that in minutes.
pub(crate) const ZERO_PAUSE: Duration = Duration::from_secs(10);
const CLEAR_TIME: Duration = Duration::from_secs(1);
/// A motor at its new zero reports a position below this, rad.
pub(super) const ZERO_TOLERANCE: f32 = 0.01;

/// The kind of a service request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    SetZero,
    ClearFault,
}

/// A service request under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ServiceRequest {
    pub(super) kind: Kind,
    /// The ticket of the answer.
    pub(super) ticket: u32,
    /// The request fails at this time.
    pub(super) deadline: Instant,
    pub(super) sent: bool,
}

impl ServiceRequest {
    pub(crate) fn new(kind: Kind, ticket: u32, now: Instant) -> Self {
        let time = match kind {
            Kind::SetZero => ZERO_TIME,
            Kind::ClearFault => CLEAR_TIME,
        };
        Self { kind, ticket, deadline: now + time, sent: false }
    }

    /// Returns whether the command of this kind was sent and its outcome is awaited.
    pub(super) fn awaits(&self, kind: Kind) -> bool {
        self.kind == kind && self.sent
    }

    /// Sends the clear again: the motor still has its fault, so the command may have been lost.
    pub(super) const fn repeat_clear(&mut self) {
        self.sent &= !matches!(self.kind, Kind::ClearFault);
    }

    /// Returns the command of this cycle.
    pub(super) const fn command(&mut self) -> Command {
        let first = !self.sent;
        self.sent = true;
        match (self.kind, first) {
            (Kind::SetZero, true) => Command::SetZero,
            (Kind::SetZero, false) => Command::Stop,
            (Kind::ClearFault, true) => Command::ClearFault,
            (Kind::ClearFault, false) => Command::GetFault,
        }
    }
}
