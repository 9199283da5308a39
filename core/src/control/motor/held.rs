//! The part of a motor whose bus is held: it gets only the commands that are granted to it.

use super::Motor;
use super::mode::Mode;
use super::turn::Access;
use crate::control::context::Context;
use motord_shared::MotorMode;

impl Motor {
    /// Records that its bus is held from now on: the motor is lost, and gets one stop.
    pub(crate) fn hold(&mut self, cx: &mut Context) {
        if self.is_offline() {
            self.mode = Mode::OFFLINE;
        } else if !self.is_excluded() {
            self.lose(cx);
            self.changed(cx);
        }
        self.applied = super::Applied::NEUTRAL;
        self.grant();
    }

    /// Grants one command, which is a probe: stops and questions for the fault in turn. A motor in
    /// fault may answer nothing else, and probes of a held bus are up to seconds apart.
    pub(crate) const fn grant(&mut self) {
        self.access = Access::Granted;
        match &mut self.mode {
            Mode::Offline(probe) | Mode::Excluded(probe) => probe.alternate(),
            Mode::Fault { queries } => *queries = true,
            _ => {}
        }
    }

    /// Records that its bus is served again.
    pub(crate) const fn release(&mut self) {
        self.access = Access::Free;
    }

    /// Returns whether its bus is held.
    pub(super) const fn is_held(&self) -> bool {
        !matches!(self.access, Access::Free)
    }

    /// Returns whether a granted command has not been sent yet.
    pub(crate) const fn is_granted(&self) -> bool {
        matches!(self.access, Access::Granted)
    }

    /// Returns whether it gets no command in this turn. Uses up a granted one.
    #[inline(always)]
    pub(super) const fn is_withheld(&mut self) -> bool {
        match self.access {
            Access::Free => false,
            Access::Held => true,
            Access::Granted => {
                self.access = Access::Held;
                false
            }
        }
    }

    pub(crate) const fn is_offline(&self) -> bool {
        matches!(self.mode.code(), MotorMode::Offline)
    }

    /// Returns the consecutive turns whose command had no answer.
    pub(crate) const fn unanswered(&self) -> u32 {
        self.replies.unanswered
    }
}
