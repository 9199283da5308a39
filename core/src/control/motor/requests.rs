//! The requests of an operator to one motor: begin, confirmation, end.

use super::Motor;
use super::mode::Mode;
use super::service::{Kind, ServiceRequest, ZERO_PAUSE, ZERO_TOLERANCE};
use crate::control::answers::Refused;
use crate::control::context::Context;
use motord_bus::Instant;
use motord_protocol::Faults;
use motord_shared::Refusal;

impl Motor {
    /// Repeats the command of its request, which the bus did not accept.
    pub(crate) const fn resume_request(&mut self) {
        if let Some(request) = &mut self.request {
            request.sent = false;
        }
    }

    /// Begins a request of an operator.
    pub(crate) fn serve(&mut self, kind: Kind, ticket: u32, now: Instant) {
        self.request = Some(ServiceRequest::new(kind, ticket, now));
        if kind == Kind::SetZero {
            self.zero_requested = Some(now);
        }
    }

    /// Returns whether its flash is spared until later: its zero was set a moment ago.
    pub(crate) fn was_zeroed(&self, now: Instant) -> bool {
        self.zero_requested.is_some_and(|at| now.since(at) < ZERO_PAUSE)
    }

    /// Refuses a request whose deadline has passed.
    pub(crate) fn watch_request(&mut self, cx: &mut Context) {
        if let Some(request) = self.request.take_if(|request| cx.now > request.deadline) {
            cx.answer(request.ticket, Err(Refused::joint(Refusal::NotConfirmed, self.joint)));
        }
    }

    pub(super) fn confirm_zero(&mut self, cx: &mut Context) {
        let position = self.measured.map_or(f32::NAN, |state| state.position);
        let at_zero = self.settings.transmission.position_to_motor(position).abs() < ZERO_TOLERANCE;
        let confirmed = |request: &mut ServiceRequest| request.awaits(Kind::SetZero) && at_zero;
        if let Some(request) = self.request.take_if(confirmed) {
            self.absence.confirm();
            cx.answer(request.ticket, Ok(()));
        }
    }

    pub(super) fn confirm_cleared(&mut self, cx: &mut Context) {
        if let Some(request) = self.request.take_if(|request| request.awaits(Kind::ClearFault)) {
            self.faults.reported = Faults::NONE;
            // An operator who clears a fault has not compared the position yet.
            if matches!(self.mode, Mode::Fault { .. }) {
                self.mode = Mode::Idle;
            } else {
                self.absence.confirm();
            }
            self.changed(cx);
            cx.answer(request.ticket, Ok(()));
        }
    }
}
