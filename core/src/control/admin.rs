//! Administrative requests: which are granted, and why the others are refused.

use super::answers::{Refused, reply};
use super::group::Group;
use super::motor::{Kind, Motor, ServiceRequest};
use super::{Control, Place};
use core::ops::Range;
use motord_bus::Instant;
use motord_shared::{AdminReply, AdminRequest, Cause, Lease, MotorMode, Operation, Phase, Refusal, message};

/// Makes leases: each differs from every other, also from those of the daemon before.
#[derive(Debug)]
pub(super) struct Leases {
    boot_id: u64,
    epoch: u32,
}

impl Leases {
    pub(super) const fn new(boot_id: u64) -> Self {
        Self { boot_id, epoch: 0 }
    }

    /// `None` when this daemon has no more leases to give.
    fn next(&mut self, group: usize) -> Option<Lease> {
        let lease = Lease::new(self.boot_id, self.epoch + 1, group)?;
        self.epoch = lease.epoch();
        Some(lease)
    }
}

impl Control {
    /// Answers a request, now or, when a motor has to answer it, later through [`next_answer`](Self::next_answer) with the
    /// same ticket. Does not allocate; bounded by groups and joints.
    pub fn request(&mut self, ticket: u32, request: &AdminRequest, now: Instant) -> Option<AdminReply> {
        self.context.now = now;
        let operation = match request.operation() {
            Ok(operation) => operation,
            Err(refused) => return Some(reply(Err(refused))),
        };
        self.groups.iter_mut().for_each(|group| group.hear_owner(request.lease, now));
        let outcome = match operation {
            Operation::SetZero => return self.serve(Kind::SetZero, ticket, request),
            Operation::ClearFault => return self.serve(Kind::ClearFault, ticket, request),
            Operation::Claim => self.claim(request),
            Operation::Release => self.release(request),
            Operation::ForceRelease => self.force_release(request),
            Operation::Enable => self.enable(request),
            Operation::Disable => self.disable(request),
            Operation::Reset => self.reset(request),
            Operation::EmergencyStop => {
                self.emergency_stop(request.pid);
                Ok(0)
            }
            Operation::Exclude => self.exclude(request, true),
            Operation::Include => self.exclude(request, false),
            Operation::Describe
            | Operation::Telemetry
            | Operation::Histograms
            | Operation::ResetTelemetry => Err((Refusal::UnknownOperation, request.operation)),
        };
        Some(reply(outcome))
    }

    fn claim(&mut self, request: &AdminRequest) -> Result<u64, Refused> {
        let index = self.one_group(request)?;
        if self.shutting_down {
            return Err((Refusal::ShuttingDown, 0));
        }
        let group = &mut self.groups[index];
        if let Some(owner) = group.owner() {
            return Err((Refusal::Owned, owner.pid));
        }
        let lease = self.leases.next(index).ok_or((Refusal::NoLease, 0))?;
        group.own(lease, request.pid, &mut self.context);
        Ok(lease.raw())
    }

    fn release(&mut self, request: &AdminRequest) -> Result<u64, Refused> {
        let mut groups = self.groups.iter_mut();
        let owned = groups.find(|group| group.is_owned_by(request.lease));
        let group = owned.ok_or((Refusal::NotOwner, 0))?;
        group.begin_damping(true, &mut self.context);
        group.disown(&mut self.context);
        Ok(0)
    }

    fn force_release(&mut self, request: &AdminRequest) -> Result<u64, Refused> {
        let index = self.one_group(request)?;
        let Self { groups, context, .. } = self;
        let group = &mut groups[index];
        if group.owner().is_none() {
            return Err((Refusal::NoOwner, 0));
        }
        if group.phase() != Phase::Disarmed {
            group.stop_for(Cause::OwnerLost, request.pid, context);
        }
        group.disown(context);
        Ok(0)
    }

    fn enable(&mut self, request: &AdminRequest) -> Result<u64, Refused> {
        let range = self.some_groups(request)?;
        for group in &self.groups[range.clone()] {
            self.may_enable(group, request.lease)?;
        }
        let Self { groups, context, .. } = self;
        groups[range].iter_mut().for_each(|group| group.start(context));
        Ok(0)
    }

    fn may_enable(&self, group: &Group, lease: u64) -> Result<(), Refused> {
        if self.shutting_down {
            return Err((Refusal::ShuttingDown, 0));
        }
        match group.cause() {
            Some(Cause::EmergencyStop) => return Err((Refusal::EmergencyStopActive, 0)),
            Some(cause) => return Err((Refusal::Latched, cause.code())),
            None => {}
        }
        if group.phase() != Phase::Disarmed {
            return Err((Refusal::NotDisarmed, message::NO_JOINT));
        }
        if group.owner().is_none() {
            return Err((Refusal::NoOwner, 0));
        }
        if lease != 0 && !group.is_owned_by(lease) {
            return Err((Refusal::NotOwner, 0));
        }
        group.motors.iter().try_for_each(|motor| self.may_start(motor))?;
        if !group.has_fresh_setpoints(&self.context) {
            return Err((Refusal::NoSetpoint, 0));
        }
        match group.first_jump(&self.context) {
            Some(motor) if motor.is_outside_limits() => Err((Refusal::OutsideLimits, motor.joint as u32)),
            Some(motor) => Err((Refusal::SetpointTooFar, motor.joint as u32)),
            None => Ok(()),
        }
    }

    fn may_start(&self, motor: &Motor) -> Result<(), Refused> {
        let detail = motor.joint as u32;
        if motor.is_excluded() {
            return if motor.settings.may_be_excluded { Ok(()) } else { Err((Refusal::Excluded, detail)) };
        }
        if self.buses[motor.settings.bus].cause().is_some() {
            return Err((Refusal::BusDown, detail));
        }
        match motor.mode() {
            // First: a motor that is not the configured one may be silent for that very reason.
            _ if motor.settings.mismatch => Err((Refusal::Mismatch, detail)),
            MotorMode::Offline => Err((Refusal::MotorOffline, detail)),
            MotorMode::Fault => Err((Refusal::MotorFault, detail)),
            _ if motor.request.is_some() => Err((Refusal::Busy, detail)),
            _ if motor.is_doubled() => Err((Refusal::DuplicateId, detail)),
            _ if !motor.is_fresh() => Err((Refusal::StateStale, detail)),
            _ => Ok(()),
        }
    }

    fn disable(&mut self, request: &AdminRequest) -> Result<u64, Refused> {
        let range = self.some_groups(request)?;
        let Self { groups, context, .. } = self;
        let groups = &mut groups[range];
        if request.lease != 0 && !groups.iter().all(|group| group.is_owned_by(request.lease)) {
            return Err((Refusal::NotOwner, 0));
        }
        for group in groups {
            if group.is_asked_by_owner(request) {
                group.begin_damping(true, context);
            } else {
                group.stop_for(Cause::Disabled, request.pid, context);
            }
        }
        Ok(0)
    }

    fn reset(&mut self, request: &AdminRequest) -> Result<u64, Refused> {
        let range = self.some_groups(request)?;
        for group in &self.groups[range.clone()] {
            self.may_reset(group)?;
        }
        let Self { groups, context, .. } = self;
        groups[range].iter_mut().for_each(|group| group.reset(context));
        Ok(0)
    }

    fn may_reset(&self, group: &Group) -> Result<(), Refused> {
        if self.shutting_down {
            return Err((Refusal::ShuttingDown, 0));
        }
        if group.phase() != Phase::Disarmed {
            return Err((Refusal::NotNeutral, 0));
        }
        for motor in group.motors.iter().filter(|motor| !motor.is_excluded()) {
            let detail = motor.joint as u32;
            match motor.mode() {
                _ if !self.buses[motor.settings.bus].is_up() => return Err((Refusal::BusDown, detail)),
                MotorMode::Offline => return Err((Refusal::MotorOffline, detail)),
                MotorMode::Fault => return Err((Refusal::MotorFault, detail)),
                _ => {}
            }
        }
        Ok(())
    }

    fn exclude(&mut self, request: &AdminRequest, excluded: bool) -> Result<u64, Refused> {
        let joint = request.joint;
        let Place { group, place } =
            *self.places.get(joint as usize).ok_or((Refusal::UnknownJoint, joint))?;
        let Self { groups, context, .. } = self;
        let group = &mut groups[group];
        if group.phase() != Phase::Disarmed {
            return Err((Refusal::NotDisarmed, joint));
        }
        if group.motors[place].request.is_some() {
            return Err((Refusal::Busy, joint));
        }
        group.exclude(place, excluded, context);
        Ok(0)
    }

    fn serve(&mut self, kind: Kind, ticket: u32, request: &AdminRequest) -> Option<AdminReply> {
        match self.may_serve(kind, request) {
            Ok(Place { group, place }) => {
                let service = ServiceRequest::new(kind, ticket, self.context.now);
                self.groups[group].motors[place].request = Some(service);
                None
            }
            Err(refused) => Some(reply(Err(refused))),
        }
    }

    fn may_serve(&self, kind: Kind, request: &AdminRequest) -> Result<Place, Refused> {
        let joint = request.joint;
        let place = *self.places.get(joint as usize).ok_or((Refusal::UnknownJoint, joint))?;
        let group = &self.groups[place.group];
        let motor = &group.motors[place.place];
        if group.phase() != Phase::Disarmed {
            return Err((Refusal::NotDisarmed, joint));
        }
        match (motor.mode(), kind) {
            (_, _) if motor.request.is_some() => Err((Refusal::Busy, joint)),
            (MotorMode::Offline, _) => Err((Refusal::MotorOffline, joint)),
            (MotorMode::Excluded, _) => Err((Refusal::Excluded, joint)),
            (MotorMode::Fault, Kind::SetZero) => Err((Refusal::MotorFault, joint)),
            // Nobody wants the momentary position of a moving joint as its zero, and its next state would not confirm it.
            (_, Kind::SetZero) if !motor.is_at_rest(self.context.safety.rest_velocity) => {
                Err((Refusal::Moving, joint))
            }
            _ => Ok(place),
        }
    }

    fn one_group(&self, request: &AdminRequest) -> Result<usize, Refused> {
        let index = request.group as usize;
        if index < self.groups.len() { Ok(index) } else { Err((Refusal::UnknownGroup, request.group)) }
    }

    fn some_groups(&self, request: &AdminRequest) -> Result<Range<usize>, Refused> {
        if request.group == message::ALL_GROUPS {
            return Ok(0..self.groups.len());
        }
        self.one_group(request).map(|index| index..index + 1)
    }
}
