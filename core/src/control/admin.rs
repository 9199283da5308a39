//! Administrative requests: who may want what, when, and why not.

use super::errand::{Errand, Kind};
use super::group::Owner;
use super::{Control, Event};
use motord_bus::Instant;
use motord_shared::{
    AdminReply, AdminRequest, BusCondition, Cause, Lease, MotorMode, Operation, Phase, Refusal, message,
};

/// A refusal and what it is about.
type Refused = (Refusal, u32);

/// Answers that came later than their request.
#[derive(Debug)]
pub(super) struct Answers {
    answers: [Option<(u32, AdminReply)>; Answers::CAPACITY],
}

impl Answers {
    /// At most one errand per motor is under way.
    const CAPACITY: usize = motord_shared::limits::JOINTS_MAX;

    pub(super) const fn new() -> Self {
        Self { answers: [None; Self::CAPACITY] }
    }

    pub(super) fn push(&mut self, ticket: u32, refusal: Option<Refusal>) {
        if let Some(free) = self.answers.iter_mut().find(|answer| answer.is_none()) {
            *free = Some((ticket, reply(refusal.map_or(Ok(0), |refusal| Err((refusal, 0))))));
        }
    }

    pub(super) fn pop(&mut self) -> Option<(u32, AdminReply)> {
        self.answers.iter_mut().find_map(Option::take)
    }
}

fn reply(outcome: Result<u64, Refused>) -> AdminReply {
    match outcome {
        Ok(lease) => AdminReply { lease, refusal: 0, detail: 0 },
        Err((refusal, detail)) => AdminReply { lease: 0, refusal: refusal.code(), detail },
    }
}

impl Control {
    /// Answers a request, now or, when it is an errand to a motor, later through
    /// [`next_answer`](Self::next_answer) with the same ticket. Bounded by groups and joints.
    pub fn request(&mut self, ticket: u32, request: &AdminRequest, now: Instant) -> Option<AdminReply> {
        self.now = now;
        let Ok(operation) = Operation::try_from(request.operation) else {
            return Some(reply(Err((Refusal::UnknownOperation, request.operation))));
        };
        if let Some(owner) = self
            .groups
            .iter_mut()
            .filter_map(|group| group.owner.as_mut())
            .find(|owner| owner.lease.raw() == request.lease)
        {
            owner.heard = now;
        }
        let outcome = match operation {
            Operation::SetZero => return self.send_errand(Kind::SetZero, ticket, request, now),
            Operation::ClearFault => return self.send_errand(Kind::ClearFault, ticket, request, now),
            Operation::Claim => self.claim(request, now),
            Operation::Release => self.release(request),
            Operation::ForceRelease => self.force_release(request),
            Operation::Enable => self.enable(request, now),
            Operation::Disable => self.disable(request),
            Operation::Reset => self.reset(request),
            Operation::EmergencyStop => self.emergency_stop(),
            Operation::Describe | Operation::Telemetry => Err((Refusal::UnknownOperation, request.operation)),
        };
        Some(reply(outcome))
    }

    fn claim(&mut self, request: &AdminRequest, now: Instant) -> Result<u64, Refused> {
        let index = self.one_group(request)?;
        if self.shutting_down {
            return Err((Refusal::ShuttingDown, 0));
        }
        if let Some(owner) = self.groups[index].owner {
            return Err((Refusal::Owned, owner.pid));
        }
        let lease = Lease::new(self.boot_id, self.epoch + 1, index).ok_or((Refusal::NoLease, 0))?;
        self.epoch = lease.epoch();
        self.groups[index].owner = Some(Owner::new(lease, request.pid, now));
        self.events.push(Event::Owner { group: index, pid: Some(request.pid) });
        Ok(lease.raw())
    }

    fn release(&mut self, request: &AdminRequest) -> Result<u64, Refused> {
        let index = Lease::from_raw(request.lease).ok_or((Refusal::NotOwner, 0))?.group();
        self.must_own(index, request.lease)?;
        self.begin_damping(index, true);
        self.disown(index);
        Ok(0)
    }

    fn force_release(&mut self, request: &AdminRequest) -> Result<u64, Refused> {
        let index = self.one_group(request)?;
        if self.groups[index].owner.is_none() {
            return Err((Refusal::NoOwner, 0));
        }
        self.stop(index, Cause::OwnerLost, None);
        self.disown(index);
        Ok(0)
    }

    fn enable(&mut self, request: &AdminRequest, now: Instant) -> Result<u64, Refused> {
        for index in self.some_groups(request)? {
            self.may_enable(index, request.lease, now)?;
        }
        for index in self.some_groups(request)? {
            for place in 0..self.groups[index].motors.len() {
                let motor = self.groups[index].motors[place];
                self.motors[motor].begin_start();
                self.motor_changed(motor);
            }
            self.groups[index].enter(Phase::Starting, now);
            self.events.push(Event::Group { group: index, phase: Phase::Starting });
        }
        Ok(0)
    }

    fn may_enable(&self, index: usize, lease: u64, now: Instant) -> Result<(), Refused> {
        let group = &self.groups[index];
        if self.shutting_down {
            return Err((Refusal::ShuttingDown, 0));
        }
        match group.cause() {
            Some(Cause::EmergencyStop) => return Err((Refusal::EmergencyStopActive, 0)),
            Some(cause) => return Err((Refusal::Latched, cause.code())),
            None => {}
        }
        if group.phase() != Phase::Disarmed {
            return Err((Refusal::NotDisarmed, 0));
        }
        if group.owner.is_none() {
            return Err((Refusal::NoOwner, 0));
        }
        if lease != 0 {
            self.must_own(index, lease)?;
        }
        for &motor in &group.motors {
            self.may_start(motor)?;
        }
        if !group.has_fresh_setpoint(now, self.safety.setpoint_timeout) {
            return Err((Refusal::NoSetpoint, 0));
        }
        match self.first_jump(index) {
            Some(motor) => Err((Refusal::SetpointTooFar, motor as u32)),
            None => Ok(()),
        }
    }

    fn may_start(&self, index: usize) -> Result<(), Refused> {
        let motor = &self.motors[index];
        let detail = index as u32;
        if self.buses[self.settings[index].bus].cause().is_some() {
            return Err((Refusal::BusDown, detail));
        }
        match motor.mode() {
            MotorMode::Offline => Err((Refusal::MotorOffline, detail)),
            MotorMode::Fault => Err((Refusal::MotorFault, detail)),
            _ if motor.errand.is_some() => Err((Refusal::Busy, detail)),
            _ if motor.is_doubled() => Err((Refusal::DuplicateId, detail)),
            _ if !motor.is_fresh() => Err((Refusal::StateStale, detail)),
            _ => Ok(()),
        }
    }

    fn disable(&mut self, request: &AdminRequest) -> Result<u64, Refused> {
        for index in self.some_groups(request)? {
            if request.lease != 0 {
                self.must_own(index, request.lease)?;
            }
        }
        self.some_groups(request)?.for_each(|index| self.begin_damping(index, true));
        Ok(0)
    }

    fn reset(&mut self, request: &AdminRequest) -> Result<u64, Refused> {
        for index in self.some_groups(request)? {
            self.may_reset(index)?;
        }
        for index in self.some_groups(request)? {
            if self.groups[index].cause().is_some() {
                self.groups[index].reset();
                self.events.push(Event::Reset { group: index });
            }
        }
        Ok(0)
    }

    fn may_reset(&self, index: usize) -> Result<(), Refused> {
        let group = &self.groups[index];
        if self.shutting_down {
            return Err((Refusal::ShuttingDown, 0));
        }
        if group.phase() != Phase::Disarmed {
            return Err((Refusal::NotNeutral, 0));
        }
        for &motor in &group.motors {
            let bus = self.buses[self.settings[motor].bus];
            if !matches!(bus.condition, BusCondition::Active | BusCondition::Warning | BusCondition::Passive)
            {
                return Err((Refusal::BusDown, motor as u32));
            }
            match self.motors[motor].mode() {
                MotorMode::Offline => return Err((Refusal::MotorOffline, motor as u32)),
                MotorMode::Fault => return Err((Refusal::MotorFault, motor as u32)),
                _ => {}
            }
        }
        Ok(())
    }

    fn emergency_stop(&mut self) -> Result<u64, Refused> {
        (0..self.groups.len()).for_each(|group| self.stop(group, Cause::EmergencyStop, None));
        Ok(0)
    }

    fn send_errand(
        &mut self,
        kind: Kind,
        ticket: u32,
        request: &AdminRequest,
        now: Instant,
    ) -> Option<AdminReply> {
        match self.may_send_errand(kind, request) {
            Ok(motor) => {
                self.motors[motor].errand = Some(Errand::new(kind, ticket, now));
                None
            }
            Err(refused) => Some(reply(Err(refused))),
        }
    }

    fn may_send_errand(&self, kind: Kind, request: &AdminRequest) -> Result<usize, Refused> {
        let motor = request.joint as usize;
        let told = self.motors.get(motor).ok_or((Refusal::UnknownJoint, request.joint))?;
        if self.groups[self.group_of[motor]].phase() != Phase::Disarmed {
            return Err((Refusal::NotDisarmed, request.joint));
        }
        match (told.mode(), kind) {
            (_, _) if told.errand.is_some() => Err((Refusal::Busy, request.joint)),
            (MotorMode::Offline, _) => Err((Refusal::MotorOffline, request.joint)),
            (MotorMode::Fault, Kind::SetZero) => Err((Refusal::MotorFault, request.joint)),
            // Where a joint is zeroed that turns is nobody's intention, and its next state does not confirm it.
            (_, Kind::SetZero) if !told.is_at_rest(self.safety.rest_velocity) => {
                Err((Refusal::Moving, request.joint))
            }
            _ => Ok(motor),
        }
    }

    fn must_own(&self, index: usize, lease: u64) -> Result<(), Refused> {
        let owner = self.groups.get(index).and_then(|group| group.owner);
        match owner {
            Some(owner) if owner.lease.raw() == lease => Ok(()),
            _ => Err((Refusal::NotOwner, 0)),
        }
    }

    fn one_group(&self, request: &AdminRequest) -> Result<usize, Refused> {
        let index = request.group as usize;
        if index < self.groups.len() { Ok(index) } else { Err((Refusal::UnknownGroup, request.group)) }
    }

    fn some_groups(&self, request: &AdminRequest) -> Result<core::ops::Range<usize>, Refused> {
        if request.group == message::ALL_GROUPS {
            return Ok(0..self.groups.len());
        }
        self.one_group(request).map(|index| index..index + 1)
    }
}
