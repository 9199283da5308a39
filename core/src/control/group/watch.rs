//! Reacts to observations: heat, buses, the owner, states, faults, missed replies.

use super::Group;
use crate::control::bus_health::BusHealth;
use crate::control::context::Context;
use crate::control::{Event, ForeignFrames};
use motord_bus::{Duration, FrameId, Instant};
use motord_protocol::drive::{JointSide, Measured, Reported, Status, Supply};
use motord_protocol::{Faults, SupplyReport};
use motord_settings::settings::FaultPolicy;
use motord_shared::{Cause, Lease, Phase};

/// The owner of a disarmed or damped group loses it after this silence, or after the setpoint
/// timeout where that is longer.
const OWNER_SILENCE: Duration = Duration::from_secs(1);

/// The consequence of a report for the other groups.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Consequence {
    /// None.
    None,
    /// Every group must be stopped for the fault of this joint.
    StopAll,
    /// The indicator with this number has this value.
    Indicator(u8, f32),
}

impl Group {
    /// Updates the heat of all windings, and stops the group when one is overheated: no limit
    /// derates the modes in which the drive controls the torque.
    pub(super) fn watch_heat(&mut self, elapsed: Duration, cx: &mut Context) {
        let elapsed = elapsed.as_secs_f64();
        let mut hottest = None;
        for motor in &mut self.motors {
            motor.warm(elapsed);
            if motor.is_overheated() {
                hottest = hottest.or(Some(motor.joint));
            }
        }
        if hottest.is_some() {
            self.stop(Cause::OverTemperature, hottest, cx);
        }
    }

    pub(super) fn watch_buses(&mut self, buses: &[BusHealth], cx: &mut Context) {
        if self.phase == Phase::Disarmed || buses.iter().all(|bus| bus.cause().is_none()) {
            return;
        }
        let mut motors = self.motors.iter();
        let broken = motors.find_map(|motor| {
            let cause = buses[motor.settings.bus].cause()?;
            (!motor.is_excluded()).then_some((cause, motor.joint))
        });
        if let Some((cause, joint)) = broken {
            self.stop(cause, Some(joint), cx);
        }
    }

    pub(super) fn watch_owner(&mut self, cx: &mut Context) {
        let Some(owner) = self.owner else { return };
        match self.phase {
            Phase::Starting | Phase::Active => {
                if !self.has_fresh_setpoints(cx) {
                    let horizon = self.setpoints.horizon;
                    self.setpoints.at_stop = self.setpoints.period().map(|period| (period, horizon));
                    if let Some(period) = self.setpoints.period() {
                        cx.push(Event::SetpointPeriod { group: self.index, period, horizon });
                    }
                    self.stop(Cause::SetpointTimeout, None, cx);
                    self.disown(cx);
                }
            }
            Phase::Disarmed | Phase::Damping => {
                if cx.now.since(owner.last_seen) > OWNER_SILENCE.max(cx.safety.setpoint_timeout) {
                    self.disown(cx);
                }
            }
        }
    }

    /// Ends the ownership of `lease`, whose process exited.
    pub(crate) fn end_owner(&mut self, lease: Lease, cx: &mut Context) {
        if !self.is_owned_by(lease) {
            return;
        }
        if matches!(self.phase, Phase::Starting | Phase::Active) {
            self.stop(Cause::OwnerDied, None, cx);
        }
        self.disown(cx);
    }

    /// Takes a reply of the motor at `slot` that arrived at `at`. Does not allocate; bounded by
    /// the motors of the group.
    pub(crate) fn receive(
        &mut self,
        slot: usize,
        reported: &Reported,
        at: Instant,
        cx: &mut Context,
    ) -> Consequence {
        let motor = &mut self.motors[slot];
        match *reported {
            Reported::State(state, latency, status) => {
                return self.receive_state(slot, state, (at, latency), status, cx);
            }
            Reported::Fault(bits) => {
                if bits.is_none() {
                    motor.hurry_probe();
                }
                return self.receive_fault(slot, bits, at, cx);
            }
            Reported::Ambiguous(bits) => motor.record_ambiguous(bits, at, cx),
            Reported::Indicator(number, value) => {
                if motor.settings.capabilities.supply == SupplyReport::Indicator(number) {
                    self.receive_supply(slot, Supply { voltage: value, current: None }, cx);
                }
                return Consequence::Indicator(number, value);
            }
            Reported::Supply(supply) => {
                motor.record_alive();
                self.receive_supply(slot, supply, cx);
            }
            Reported::Register(number, value) => motor.record_register(number, value, cx),
            Reported::Cleared | Reported::Alive => motor.record_alive(),
            Reported::Stopped => motor.record_stop(),
            Reported::Refused => motor.record_refusal(),
            Reported::LateRegister(number, value) => {
                motor.record_late();
                motor.record_register(number, value, cx);
            }
            Reported::Late => motor.record_late(),
            Reported::Unprompted => {}
        }
        Consequence::None
    }

    /// Takes a state of the motor at `slot` that arrived `latency` after its command.
    #[inline(always)]
    pub(crate) fn receive_state(
        &mut self,
        slot: usize,
        state: Measured<JointSide>,
        (at, latency): (Instant, Duration),
        status: Status,
        cx: &mut Context,
    ) -> Consequence {
        let by_faults =
            status.faults.map_or(Consequence::None, |faults| self.receive_fault(slot, faults, at, cx));
        let motor = &mut self.motors[slot];
        motor.record_unnamed_fault(status.has_unnamed_fault);
        if let Err(cause) = motor.record_state(state, at, latency, status.runs, cx) {
            let joint = motor.joint;
            self.stop(cause, Some(joint), cx);
        }
        by_faults
    }

    fn receive_fault(&mut self, slot: usize, bits: Faults, at: Instant, cx: &mut Context) -> Consequence {
        let motor = &mut self.motors[slot];
        if motor.is_excluded() {
            return Consequence::None;
        }
        motor.record_fault(bits, at, cx);
        if bits.is_none() {
            return Consequence::None;
        }
        self.over_voltage |= bits.has(Faults::OVER_VOLTAGE);
        match motor.settings.fault_policy {
            FaultPolicy::StopJoint => {}
            FaultPolicy::StopGroup => {
                let joint = motor.joint;
                self.stop(Cause::MotorFault, Some(joint), cx);
            }
            FaultPolicy::StopAll => return Consequence::StopAll,
        }
        Consequence::None
    }

    /// Takes the supply that the motor at `slot` reports.
    #[cold]
    fn receive_supply(&mut self, slot: usize, supply: Supply, cx: &mut Context) {
        let motor = &mut self.motors[slot];
        motor.record_supply(supply, cx.now);
        let (joint, group) = (motor.joint, self.index);
        if let Some(is_low) = self.supply.update(&self.motors, cx.now) {
            cx.push(Event::Supply { group, motor: joint, voltage: supply.voltage, is_low });
        }
        if self.supply.forbids_motion() {
            self.stop(Cause::SupplyLow, Some(joint), cx);
        }
    }

    /// Records that the motor at `slot` answered one question twice.
    pub(crate) fn receive_duplicate(&mut self, slot: usize, cx: &mut Context) {
        let motor = &mut self.motors[slot];
        if motor.record_duplicate() {
            let joint = motor.joint;
            self.stop(Cause::DuplicateId, Some(joint), cx);
        }
    }

    /// Records `frames` by which another sender commanded the motor at `slot`.
    pub(crate) fn receive_foreign(
        &mut self,
        slot: usize,
        (id, frames): (FrameId, ForeignFrames),
        at: Instant,
        cx: &mut Context,
    ) {
        let motor = &mut self.motors[slot];
        let is_master = motor.record_foreign(id, frames, at, cx);
        let joint = motor.joint;
        if is_master && cx.safety.stop_on_foreign_master && self.phase != Phase::Disarmed {
            self.stop(Cause::ForeignMaster, Some(joint), cx);
        }
    }

    /// Begins a cycle: ends the previous turn of each motor whose turn it is.
    pub(crate) fn begin_turns(&mut self, cx: &mut Context) {
        if !self.has_turns {
            return;
        }
        for slot in 0..self.motors.len() {
            let turn = &mut self.motors[slot].turn;
            if turn.outlasts_cycle && turn.begin_cycle(cx.now, cx.period) {
                self.end_turn(slot, cx);
            }
        }
    }

    /// Ends the turns that last for one cycle: no further reply of it is read.
    pub(crate) fn end_cycle(&mut self, cx: &mut Context) {
        for slot in 0..self.motors.len() {
            if !self.motors[slot].turn.outlasts_cycle {
                self.end_turn(slot, cx);
            }
        }
    }

    /// Ends the turn of the motor at `slot`. A lost motor stops the group, after the others of its
    /// bus have been checked.
    #[inline(always)]
    fn end_turn(&mut self, slot: usize, cx: &mut Context) {
        let motor = &mut self.motors[slot];
        if motor.end_turn(cx) {
            motor.changed(cx);
            cx.note_lost(motor.joint);
        }
    }
}
