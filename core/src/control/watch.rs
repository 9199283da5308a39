//! Draws the consequences of what was seen: time, buses, owners, errands, states and faults.

use super::errand::{Kind, ZERO_TOLERANCE};
use super::plausibility::Verdict;
use super::{Control, Event, Wake};
use crate::joint::{Joint, Measured};
use crate::settings::FaultPolicy;
use motord_bus::{Duration, Instant};
use motord_protocol::FaultBits;
use motord_shared::{Cause, Phase, Refusal};

/// The owner of a stopped group that says nothing for this long has gone.
const OWNER_SILENCE: Duration = Duration::from_secs(1);
/// How long a missed tick is remembered.
const MISSED_TICKS_TIME: Duration = Duration::from_secs(1);
/// A computer takes longer than this to be suspended and woken; the readings of two clocks differ by less.
const SUSPENDED_LEAST: Duration = Duration::from_millis(10);
/// A motor that has not answered by then is told of, once.
const SILENT_START: Duration = Duration::from_secs(2);

impl Control {
    /// The tick before this one began `elapsed` ago.
    pub(super) fn watch_time(&mut self, elapsed: Duration) {
        let Wake { scheduled, begun, missed_ticks, suspended, .. } = self.tick;
        if missed_ticks > 0 {
            self.events.push(Event::Overrun { missed_ticks });
        }
        let weight = (elapsed.as_secs_f32() / MISSED_TICKS_TIME.as_secs_f32()).min(1.0);
        self.missed_ticks += weight * (missed_ticks as f32 / (missed_ticks + 1) as f32 - self.missed_ticks);
        let known = self.suspended;
        self.suspended = known.max(suspended);
        if begun.since(scheduled) >= self.max_lateness {
            self.stop_moving(Cause::TimeBase);
        } else if suspended > known + SUSPENDED_LEAST {
            self.stop_moving(Cause::Suspended);
        } else if self.missed_ticks > self.max_missed_ticks {
            self.stop_moving(Cause::Overload);
        }
    }

    /// Tells once of the motors that have never answered.
    pub(super) fn watch_silence(&mut self) {
        let started = *self.started.get_or_insert(self.tick.begun);
        if self.told_silent || self.tick.begun.since(started) < SILENT_START {
            return;
        }
        self.told_silent = true;
        for (motor, _) in self.motors.iter().enumerate().filter(|(_, motor)| motor.was_never_heard()) {
            self.events.push(Event::Silent { motor });
        }
    }

    /// In the modes of a drive that leave the torque to it, nothing can be derated: the group is stopped instead.
    pub(super) fn watch_heat(&mut self, elapsed: Duration) {
        for motor in 0..self.motors.len() {
            self.motors[motor].warm(elapsed);
            if self.motors[motor].heat.is_overheated() {
                self.stop(self.group_of[motor], Cause::OverTemperature, Some(motor));
            }
        }
    }

    pub(super) fn watch_buses(&mut self, group: usize) {
        if self.groups[group].phase() == Phase::Disarmed {
            return;
        }
        let broken =
            |motor: &usize| self.buses[self.settings[*motor].bus].cause().map(|cause| (cause, *motor));
        if let Some((cause, motor)) = self.groups[group].motors.iter().find_map(broken) {
            self.stop(group, cause, Some(motor));
        }
    }

    pub(super) fn watch_owner(&mut self, index: usize) {
        let now = self.tick.begun;
        let group = &self.groups[index];
        let Some(owner) = group.owner else { return };
        match group.phase() {
            Phase::Starting | Phase::Active => {
                if !group.has_fresh_setpoint(now, self.safety.setpoint_timeout) {
                    self.stop(index, Cause::SetpointTimeout, None);
                    self.disown(index);
                }
            }
            Phase::Disarmed | Phase::Damping => {
                if now.since(owner.heard) > OWNER_SILENCE.max(self.safety.setpoint_timeout) {
                    self.disown(index);
                }
            }
        }
    }

    pub(super) fn watch_errands(&mut self) {
        for motor in &mut self.motors {
            if let Some(errand) = motor.errand.filter(|errand| self.tick.begun > errand.deadline) {
                motor.errand = None;
                self.answers.push(errand.ticket, Some(Refusal::NotConfirmed));
            }
        }
    }

    pub(super) fn heard_state(
        &mut self,
        motor: usize,
        told: Measured<Joint>,
        at: Instant,
        latency: Duration,
    ) -> bool {
        let (measured, cause) = match self.motors[motor].judge(told, at, &self.settings[motor]) {
            Verdict::Sound(measured) => (measured, None),
            Verdict::Stop(measured, cause) => (measured, Some(cause)),
            Verdict::Unbelievable => {
                self.motors[motor].told_alive();
                return false;
            }
        };
        if self.motors[motor].told_state(measured, at, latency) {
            self.motor_changed(motor);
        }
        self.confirm_zero(motor);
        if let Some(cause) = cause {
            self.stop(self.group_of[motor], cause, Some(motor));
        }
        true
    }

    pub(super) fn heard_fault(&mut self, motor: usize, bits: FaultBits, at: Instant) {
        let period = Duration::from_secs_f64(1.0 / self.safety.fault_poll_hz.max(0.01));
        let before = self.motors[motor].mode();
        if self.motors[motor].told_fault(bits, at, period) {
            self.events.push(Event::Fault { motor, bits: bits.0 });
        }
        if bits.is_none() {
            return self.confirm_cleared(motor);
        }
        if let Some(errand) = &mut self.motors[motor].errand {
            errand.repeat_clear();
        }
        if self.motors[motor].mode() != before {
            self.motor_changed(motor);
        }
        let group = self.group_of[motor];
        self.groups[group].over_voltage |= bits.0 & FaultBits::OVER_VOLTAGE != 0;
        match self.settings[motor].fault_policy {
            FaultPolicy::StopJoint => {}
            FaultPolicy::StopGroup => self.stop(group, Cause::MotorFault, Some(motor)),
            FaultPolicy::StopAll => {
                (0..self.groups.len()).for_each(|group| self.stop(group, Cause::MotorFault, Some(motor)));
            }
        }
    }

    pub(super) fn confirm_zero(&mut self, motor: usize) {
        let settings = &self.settings[motor];
        let told = &self.motors[motor];
        let Some(errand) = told.errand.filter(|errand| errand.kind == Kind::SetZero && errand.sent) else {
            return;
        };
        let at_zero = told.measured().is_some_and(|told| {
            settings.transmission.position_to_motor(told.position).abs() < ZERO_TOLERANCE
        });
        if at_zero {
            self.motors[motor].errand = None;
            self.answers.push(errand.ticket, None);
        }
    }

    pub(super) fn confirm_cleared(&mut self, motor: usize) {
        let Some(errand) =
            self.motors[motor].errand.filter(|errand| errand.kind == Kind::ClearFault && errand.sent)
        else {
            return;
        };
        self.motors[motor].errand = None;
        self.motors[motor].cleared();
        self.motor_changed(motor);
        self.answers.push(errand.ticket, None);
    }
}
