//! Administrative requests: which are granted, and why the others are refused.

use super::answers::{Refused, reply};
use super::group::Group;
use super::motor::{Kind, Motor};
use super::requester::{Requester, Right};
use super::{Control, GroupSlot};
use core::ops::Range;
use motord_bus::Instant;
use motord_shared::{AdminReply, AdminRequest, Cause, Lease, MotorMode, Operation, Phase, Refusal, message};

/// The lease that a request was granted, if it claims one.
type Granted = Result<Option<Lease>, Refused>;

/// The content of a request, without codes and sentinels of the wire. Indices of groups and joints
/// are not checked yet.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Request {
    Claim(usize),
    Release,
    ForceRelease(usize),
    Enable(Groups),
    Disable(Groups),
    Reset(Groups),
    EmergencyStop,
    Exclude(usize),
    Include(usize),
    Serve(Kind, usize),
}

/// The groups that a request is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Groups {
    All,
    One(usize),
}

impl Request {
    /// Converts a request.
    ///
    /// # Errors
    ///
    /// When it is malformed, or its operation is unknown or not one of the cycle.
    fn read(request: &AdminRequest) -> Result<Self, Refused> {
        let (group, joint) = (request.group as usize, request.joint as usize);
        let groups = if request.group == message::ALL_GROUPS { Groups::All } else { Groups::One(group) };
        let operation = request.operation().map_err(|(reason, number)| match reason {
            Refusal::UnknownOperation => Refused::unknown(reason, number),
            _ => Refused::new(reason),
        })?;
        Ok(match operation {
            Operation::Claim => Self::Claim(group),
            Operation::Release => Self::Release,
            Operation::ForceRelease => Self::ForceRelease(group),
            Operation::Enable => Self::Enable(groups),
            Operation::Disable => Self::Disable(groups),
            Operation::Reset => Self::Reset(groups),
            Operation::EmergencyStop => Self::EmergencyStop,
            Operation::Exclude => Self::Exclude(joint),
            Operation::Include => Self::Include(joint),
            Operation::SetZero => Self::Serve(Kind::SetZero, joint),
            Operation::ClearFault => Self::Serve(Kind::ClearFault, joint),
            Operation::Describe
            | Operation::Telemetry
            | Operation::Histograms
            | Operation::ResetTelemetry => {
                return Err(Refused::unknown(Refusal::UnknownOperation, request.operation));
            }
        })
    }
}

impl Control {
    /// Answers a request. A request that a motor must confirm is answered later, by
    /// [`next_answer`](Self::next_answer) with the same ticket. Does not allocate; bounded by
    /// groups and joints.
    pub fn request(&mut self, ticket: u32, request: &AdminRequest, now: Instant) -> Option<AdminReply> {
        self.context.now = now;
        let requester = Requester::of(request);
        let request = match Request::read(request) {
            Ok(request) => request,
            Err(refused) => return Some(reply(Err(refused))),
        };
        if let Some(lease) = requester.lease() {
            self.groups.iter_mut().for_each(|group| group.refresh_owner(lease, now));
        }
        let outcome = match request {
            Request::Serve(kind, joint) => match self.serve(kind, ticket, joint) {
                Ok(()) => return None,
                Err(refused) => Err(refused),
            },
            Request::Claim(group) => self.claim(group, &requester),
            Request::Release => self.release(&requester),
            Request::ForceRelease(group) => self.force_release(group, &requester),
            Request::Enable(groups) => self.enable(groups, &requester),
            Request::Disable(groups) => self.disable(groups, &requester),
            Request::Reset(groups) => self.reset(groups),
            Request::EmergencyStop => {
                self.emergency_stop(requester.pid);
                Ok(None)
            }
            Request::Exclude(joint) => self.exclude(joint, true),
            Request::Include(joint) => self.exclude(joint, false),
        };
        Some(reply(outcome))
    }

    fn claim(&mut self, group: usize, requester: &Requester) -> Granted {
        let index = self.one_group(group)?;
        if self.shutting_down {
            return Err(Refused::new(Refusal::ShuttingDown));
        }
        let group = &mut self.groups[index];
        if let Some(owner) = group.owner() {
            return Err(Refused::owned(owner.pid));
        }
        let lease = self.leases.next(index).ok_or(Refused::new(Refusal::NoLease))?;
        group.own(lease, requester.pid, &mut self.context);
        Ok(Some(lease))
    }

    fn release(&mut self, requester: &Requester) -> Granted {
        let owned =
            requester.lease().and_then(|lease| self.groups.iter_mut().find(|group| group.is_owned_by(lease)));
        let group = owned.ok_or(Refused::new(Refusal::NotOwner))?;
        group.begin_damping(true, &mut self.context);
        group.disown(&mut self.context);
        Ok(None)
    }

    fn force_release(&mut self, group: usize, requester: &Requester) -> Granted {
        let index = self.one_group(group)?;
        let Self { groups, context, .. } = self;
        let group = &mut groups[index];
        if group.owner().is_none() {
            return Err(Refused::new(Refusal::NoOwner));
        }
        if group.phase() != Phase::Disarmed {
            group.stop_for(Cause::OwnerLost, requester.pid, context);
        }
        group.disown(context);
        Ok(None)
    }

    fn enable(&mut self, groups: Groups, requester: &Requester) -> Granted {
        let range = self.some_groups(groups)?;
        for group in &self.groups[range.clone()] {
            self.may_enable(group, requester.right)?;
        }
        let Self { groups, context, .. } = self;
        groups[range].iter_mut().for_each(|group| group.start(context));
        Ok(None)
    }

    fn may_enable(&self, group: &Group, right: Right) -> Result<(), Refused> {
        if self.shutting_down {
            return Err(Refused::new(Refusal::ShuttingDown));
        }
        if self.imus.forbid_motion() {
            return Err(Refused::new(Refusal::ImuLost));
        }
        match group.cause() {
            Some(Cause::EmergencyStop) => return Err(Refused::new(Refusal::EmergencyStopActive)),
            Some(cause) => return Err(Refused::latched(cause)),
            None => {}
        }
        if !group.has_supply(self.context.now) {
            return Err(Refused::new(Refusal::SupplyLow));
        }
        if group.phase() != Phase::Disarmed {
            return Err(Refused::new(Refusal::NotDisarmed));
        }
        if group.owner().is_none() {
            return Err(Refused::new(Refusal::NoOwner));
        }
        if !group.obeys(right) {
            return Err(Refused::new(Refusal::NotOwner));
        }
        group.motors.iter().try_for_each(|motor| self.may_start(motor))?;
        if !group.has_fresh_setpoints(&self.context) {
            return Err(Refused::new(Refusal::NoSetpoint));
        }
        match group.first_jump(&self.context) {
            Some(motor) if motor.is_outside_limits() => {
                Err(Refused::joint(Refusal::OutsideLimits, motor.joint))
            }
            Some(motor) => Err(Refused::joint(Refusal::SetpointTooFar, motor.joint)),
            None => Ok(()),
        }
    }

    fn may_start(&self, motor: &Motor) -> Result<(), Refused> {
        let joint = motor.joint;
        if motor.is_excluded() {
            return if motor.settings.may_be_excluded {
                Ok(())
            } else {
                Err(Refused::joint(Refusal::Excluded, joint))
            };
        }
        if self.buses[motor.settings.bus].cause().is_some() {
            return Err(Refused::joint(Refusal::BusDown, joint));
        }
        match motor.mode() {
            // First: a motor that is not the configured one may be silent because of that.
            _ if motor.is_mismatched => Err(Refused::joint(Refusal::Mismatch, joint)),
            MotorMode::Offline => Err(Refused::joint(Refusal::MotorOffline, joint)),
            MotorMode::Fault => Err(Refused::joint(Refusal::MotorFault, joint)),
            _ if motor.request.is_some() => Err(Refused::joint(Refusal::Busy, joint)),
            _ if motor.has_wrong_register() => Err(Refused::joint(Refusal::Mismatch, joint)),
            _ if !motor.is_read() => Err(Refused::joint(Refusal::Unread, joint)),
            _ if motor.is_doubled() => Err(Refused::joint(Refusal::DuplicateId, joint)),
            _ if motor.is_commanded_elsewhere(self.context.now) => {
                Err(Refused::joint(Refusal::ForeignMaster, joint))
            }
            _ if !motor.is_fresh() => Err(Refused::joint(Refusal::StateStale, joint)),
            _ if motor.lost_turns() => Err(Refused::joint(Refusal::TurnLost, joint)),
            _ => Ok(()),
        }
    }

    fn disable(&mut self, groups: Groups, requester: &Requester) -> Granted {
        let range = self.some_groups(groups)?;
        let Self { groups, context, .. } = self;
        let groups = &mut groups[range];
        if !groups.iter().all(|group| group.obeys(requester.right)) {
            return Err(Refused::new(Refusal::NotOwner));
        }
        for group in groups {
            if group.is_asked_by_owner(requester) {
                group.begin_damping(true, context);
            } else {
                group.stop_for(Cause::Disabled, requester.pid, context);
            }
        }
        Ok(None)
    }

    fn reset(&mut self, groups: Groups) -> Granted {
        let range = self.some_groups(groups)?;
        for group in &self.groups[range.clone()] {
            self.may_reset(group)?;
        }
        let Self { groups, context, .. } = self;
        groups[range].iter_mut().for_each(|group| group.reset(context));
        Ok(None)
    }

    fn may_reset(&self, group: &Group) -> Result<(), Refused> {
        if self.shutting_down {
            return Err(Refused::new(Refusal::ShuttingDown));
        }
        if group.phase() != Phase::Disarmed {
            return Err(Refused::new(Refusal::NotNeutral));
        }
        for motor in group.motors.iter().filter(|motor| !motor.is_excluded()) {
            let joint = motor.joint;
            match motor.mode() {
                _ if !self.buses[motor.settings.bus].is_served() => {
                    return Err(Refused::joint(Refusal::BusDown, joint));
                }
                MotorMode::Offline => return Err(Refused::joint(Refusal::MotorOffline, joint)),
                MotorMode::Fault => return Err(Refused::joint(Refusal::MotorFault, joint)),
                _ => {}
            }
        }
        Ok(())
    }

    fn exclude(&mut self, joint: usize, excluded: bool) -> Granted {
        let GroupSlot { group, slot } =
            *self.slots.get(joint).ok_or(Refused::unknown(Refusal::UnknownJoint, joint as u32))?;
        let Self { groups, context, .. } = self;
        let group = &mut groups[group];
        if group.phase() != Phase::Disarmed {
            return Err(Refused::joint(Refusal::NotDisarmed, joint));
        }
        if group.motors[slot].request.is_some() {
            return Err(Refused::joint(Refusal::Busy, joint));
        }
        group.exclude(slot, excluded, context);
        Ok(None)
    }

    fn serve(&mut self, kind: Kind, ticket: u32, joint: usize) -> Result<(), Refused> {
        let GroupSlot { group, slot } = self.may_serve(kind, joint)?;
        let now = self.context.now;
        self.groups[group].motors[slot].serve(kind, ticket, now);
        Ok(())
    }

    fn may_serve(&self, kind: Kind, joint: usize) -> Result<GroupSlot, Refused> {
        let entry = *self.slots.get(joint).ok_or(Refused::unknown(Refusal::UnknownJoint, joint as u32))?;
        let group = &self.groups[entry.group];
        let motor = &group.motors[entry.slot];
        if group.phase() != Phase::Disarmed {
            return Err(Refused::joint(Refusal::NotDisarmed, joint));
        }
        if self.buses[motor.settings.bus].hold.is_some() {
            return Err(Refused::joint(Refusal::BusDown, joint));
        }
        match (motor.mode(), kind) {
            (_, _) if motor.request.is_some() => Err(Refused::joint(Refusal::Busy, joint)),
            (MotorMode::Offline, _) => Err(Refused::joint(Refusal::MotorOffline, joint)),
            (MotorMode::Excluded, _) => Err(Refused::joint(Refusal::Excluded, joint)),
            (MotorMode::Fault, Kind::SetZero) => Err(Refused::joint(Refusal::MotorFault, joint)),
            (_, Kind::SetZero) if !motor.is_read() => Err(Refused::joint(Refusal::Unread, joint)),
            // The next state of a moving joint would not confirm its zero.
            (_, Kind::SetZero) if !motor.is_at_rest(self.context.safety.rest_velocity) => {
                Err(Refused::joint(Refusal::Moving, joint))
            }
            (_, Kind::SetZero) if motor.was_zeroed(self.context.now) => {
                Err(Refused::joint(Refusal::TooSoon, joint))
            }
            _ => Ok(entry),
        }
    }

    fn one_group(&self, group: usize) -> Result<usize, Refused> {
        let unknown = Refused::unknown(Refusal::UnknownGroup, group as u32);
        if group < self.groups.len() { Ok(group) } else { Err(unknown) }
    }

    fn some_groups(&self, groups: Groups) -> Result<Range<usize>, Refused> {
        match groups {
            Groups::All => Ok(0..self.groups.len()),
            Groups::One(group) => self.one_group(group).map(|index| index..index + 1),
        }
    }
}
