//! Holds a bus none of whose motors answers any more: most likely they lost their power.
//!
//! A CAN controller repeats a frame until another node acknowledges it. Without a motor that has
//! power, frames wait in the controller, the adapter and the kernel, and are sent when the power
//! returns. A motor that needs no enable would follow them. So the bus gets no commands, its queue
//! is emptied, and each motor must answer a probe before the bus is served again. [`Hold`] has the
//! diagram.
//!
//! A probe is a stop, a question for faults or a register: one motor of the bus at a time, each
//! [`PROBE_PERIOD`]. A motor that misses one must answer again. Excluded motors are not awaited.

use super::bus_health::{Hold, STALL_CYCLES};
use super::context::Joints;
use super::motor::Motor;
use super::{Control, Event, GroupSlot};
use motord_bus::{Duration, Instant};
use motord_shared::{BusCondition, Cause};

/// Interval between two probes of a held bus.
const PROBE_PERIOD: Duration = Duration::from_millis(100);
/// The same while its controller is error passive and no motor answers: no node acknowledges, so
/// the last probe still waits. Some drivers do not report that a controller has recovered.
const PASSIVE_PERIOD: Duration = Duration::from_secs(1);
/// Time for another thread to empty the queue. Afterwards the probes follow what is left in it.
const EMPTY_TIME: Duration = Duration::from_secs(1);

impl Control {
    /// Stops the groups of the motors that were lost, holds their buses if no other motor answers,
    /// and continues the holds. Bounded by motors; nothing to do in most cycles.
    #[inline]
    pub(super) fn watch_silence(&mut self) {
        self.stop_for_lost_motors();
        for bus in 0..self.buses.len() {
            if self.buses[bus].is_stalled() {
                self.check_stall(bus);
            }
            if let Some(hold) = self.buses[bus].hold {
                self.advance_hold(bus, hold);
            }
        }
    }

    /// Stops the groups of the motors that were lost since the last call, and holds a bus on which
    /// no motor answers any more.
    #[inline]
    pub(super) fn stop_for_lost_motors(&mut self) {
        if self.context.has_lost() {
            self.stop_for_lost();
        }
    }

    #[cold]
    fn stop_for_lost(&mut self) {
        let lost = self.context.take_lost();
        // Motors whose power fails together miss their first reply in the same turn or the next.
        let half = self.context.safety.lost_cycles / 2;
        for joint in lost.iter() {
            let bus = self.motor(joint).settings.bus;
            let loses_frames = self.context.loses_frames(bus);
            let mut cause = if loses_frames { Cause::FramesLost } else { Cause::MotorLost };
            let silent = self.silent_motors(bus, lost, |motor| motor.unanswered() >= half);
            if silent > 0 {
                if silent > 1 && !loses_frames {
                    cause = Cause::PowerLost;
                }
                self.hold(bus, cause);
            }
            let GroupSlot { group, .. } = self.slots[joint];
            self.groups[group].stop(cause, Some(joint), &mut self.context);
        }
    }

    /// Holds a bus that accepts no frames, if none of its motors has answered since.
    #[cold]
    fn check_stall(&mut self, bus: usize) {
        let silent = self.silent_motors(bus, Joints::NONE, |motor| motor.unanswered() >= STALL_CYCLES);
        match silent {
            0 => {}
            1 => self.hold(bus, Cause::TransmitStall),
            _ => self.hold(bus, Cause::PowerLost),
        }
    }

    /// Returns the number of motors that fell silent: those that were `lost`, and the others that
    /// are not offline. 0 if one of these is not silent, or the bus is not served. Excluded motors
    /// do not count.
    fn silent_motors(&self, bus: usize, lost: Joints, is_silent: impl Fn(&Motor) -> bool) -> usize {
        if !self.buses[bus].is_served() {
            return 0;
        }
        let mut silent = 0;
        for motor in self.motors_of(bus).filter(|motor| !motor.is_excluded()) {
            let is_lost = lost.contains(motor.joint);
            match motor.is_offline() {
                true => silent += usize::from(is_lost),
                false if is_silent(motor) => silent += 1,
                false => return 0,
            }
        }
        silent
    }

    /// Holds a bus, and stops the groups of its motors for `cause`.
    fn hold(&mut self, bus: usize, cause: Cause) {
        let Self { groups, slots, buses, context, .. } = self;
        let health = &mut buses[bus];
        health.begin_hold();
        context.push(Event::Bus { bus, condition: BusCondition::Held });
        for &joint in &health.joints {
            let GroupSlot { group, slot } = slots[joint];
            groups[group].motors[slot].hold(context);
        }
        for &joint in &health.joints {
            groups[slots[joint].group].stop(cause, Some(joint), context);
        }
    }

    #[cold]
    fn advance_hold(&mut self, bus: usize, hold: Hold) {
        let now = self.context.now;
        let probing = Hold::Probing { last: Instant::ZERO, turn: 0 };
        let next = match hold {
            Hold::Stopping if self.motors_of(bus).any(Motor::is_granted) => hold,
            Hold::Stopping if self.buses[bus].is_line => probing,
            Hold::Stopping => Hold::Emptying { until: now + EMPTY_TIME },
            Hold::Emptying { until } if now < until => hold,
            Hold::Emptying { .. } => probing,
            Hold::Probing { .. } if self.have_answered(bus) => return self.resume(bus),
            Hold::Probing { last, turn } => self.probe(bus, last, turn),
        };
        self.buses[bus].hold = Some(next);
    }

    /// Returns whether every motor of the bus that is not excluded answered its last probe.
    fn have_answered(&self, bus: usize) -> bool {
        self.buses[bus].is_up() && self.motors_of(bus).all(|motor| motor.is_excluded() || !motor.is_offline())
    }

    /// Grants a probe to the next motor, if it is time.
    fn probe(&mut self, bus: usize, last: Instant, turn: usize) -> Hold {
        let now = self.context.now;
        let health = &self.buses[bus];
        let waits = health.condition == BusCondition::Passive
            && self.motors_of(bus).all(|motor| motor.is_offline() || motor.is_excluded());
        let period = if waits { PASSIVE_PERIOD } else { PROBE_PERIOD };
        if now.since(last) < period || !health.may_be_probed() {
            return Hold::Probing { last, turn };
        }
        let Self { groups, slots, buses, .. } = self;
        let joints = &buses[bus].joints;
        let GroupSlot { group, slot } = slots[joints[turn]];
        groups[group].motors[slot].grant();
        Hold::Probing { last: now, turn: (turn + 1) % joints.len() }
    }

    /// Serves the bus again.
    fn resume(&mut self, bus: usize) {
        let Self { groups, slots, buses, context, .. } = self;
        let health = &mut buses[bus];
        health.hold = None;
        for &joint in &health.joints {
            let GroupSlot { group, slot } = slots[joint];
            groups[group].motors[slot].release();
        }
        context.push(Event::Bus { bus, condition: health.condition });
    }

    /// Returns whether the queue of a held bus should be emptied.
    #[inline]
    #[must_use]
    pub fn is_emptying(&self, bus: usize) -> bool {
        matches!(self.buses[bus].hold, Some(Hold::Emptying { .. }))
    }

    /// Records that no frame waits in the queue of a bus.
    pub fn bus_emptied(&mut self, bus: usize) {
        let health = &mut self.buses[bus];
        if matches!(health.hold, Some(Hold::Stopping | Hold::Emptying { .. })) {
            health.hold = Some(Hold::Probing { last: Instant::ZERO, turn: 0 });
        }
    }

    /// Returns whether requests to sensors would wait: the bus is being emptied, or is held and no
    /// node acknowledges.
    #[must_use]
    pub fn withholds_requests(&self, bus: usize) -> bool {
        let health = &self.buses[bus];
        let is_passive = health.condition == BusCondition::Passive;
        self.is_emptying(bus) || is_passive && health.hold.is_some()
    }

    fn motors_of(&self, bus: usize) -> impl Iterator<Item = &Motor> {
        self.buses[bus].joints.iter().map(|&joint| self.motor(joint))
    }
}
