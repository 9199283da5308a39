//! Reads the registers of a motor while it is stopped.

use super::Motor;
use super::mode::Mode;
use super::registers::Registers;
use crate::control::Event;
use crate::control::context::Context;

impl Motor {
    /// Returns whether its registers are read or assumed, and permit a start.
    pub(crate) const fn is_read(&self) -> bool {
        self.registers.permits_start()
    }

    /// Returns whether a register has a value with which its group may not start.
    pub(crate) const fn has_wrong_register(&self) -> bool {
        self.registers.wrong.is_some() && !self.is_read()
    }

    /// Returns whether it answers, and its registers are not read or do not permit a start.
    pub(super) const fn is_unread(&self) -> bool {
        !self.is_read() && !matches!(self.mode, Mode::Offline(_) | Mode::Excluded(_))
    }

    /// Returns the ends of its codes, where its registers contain them and are read or assumed.
    pub(crate) fn reported_ends(&self) -> Option<[f32; 3]> {
        (self.settings.capabilities.scales_by_registers && self.is_read()).then_some(self.registers.values)
    }

    /// Requires another reading of its registers before its next start.
    pub(crate) const fn expire_registers(&mut self) {
        self.registers.expire();
    }

    /// Returns the register to request in this turn. Only a motor that confirmed its stop is asked:
    /// the request takes the place of a stop, and the answer may change the scales of its codes.
    pub(super) fn register_to_read(&mut self, cx: &mut Context) -> Option<u8> {
        if self.may_run || !matches!(self.mode, Mode::Idle | Mode::Fault { .. }) {
            return None;
        }
        let (number, is_unread) = self.registers.request(cx.now)?;
        if is_unread {
            let is_assumed = self.registers.assume(&self.settings.registers);
            self.take_ends();
            cx.push(Event::Unread { motor: self.joint, is_assumed });
        }
        Some(number)
    }

    /// Returns whether its states have no meaning, because the ends of its codes are not known.
    pub(super) fn is_meaningless(&self) -> bool {
        self.registers.is_unknown() && self.settings.capabilities.scales_by_registers
    }

    /// Takes a state without a meaning: the motor answers, and may report whether it `runs`.
    #[cold]
    pub(super) fn record_meaningless(&mut self, runs: Option<bool>, cx: &mut Context) {
        self.confirm_stop(runs);
        // It may run since before the daemon started.
        self.may_run |= runs == Some(true);
        self.record_alive();
        if matches!(self.mode, Mode::Offline(_)) {
            self.mode = if self.faults.reported.is_none() { Mode::Idle } else { Mode::FAULT };
            self.changed(cx);
        }
    }

    /// Takes the value of a register. With the last one, decides whether its group may start.
    #[cold]
    pub(crate) fn record_register(&mut self, number: u8, value: f32, cx: &mut Context) {
        self.replies.alive();
        if !self.registers.take(number, value, &self.settings.registers) {
            return;
        }
        self.registers.check(&self.settings.registers, cx.now);
        self.take_ends();
        let is_changed = self.registers.take_change();
        if is_changed || !self.is_read() {
            // Other ends give the last state another meaning.
            self.leave();
        }
        if is_changed {
            let Registers { values, wrong, .. } = self.registers;
            cx.push(Event::Registers { motor: self.joint, values, wrong });
        }
    }

    /// Uses, to check states, the ends that the motor reported, or that are assumed.
    fn take_ends(&mut self) {
        if let Some(ends @ [position, velocity, _]) = self.reported_ends() {
            let capabilities = &mut self.settings.capabilities;
            (capabilities.position_end, capabilities.velocity_end) = (Some(position), Some(velocity));
            self.response.rescale(&self.settings, ends);
        }
    }
}
