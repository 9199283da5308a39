//! One group of joints: who owns it, what its owner asks, and whether it may move.
//!
//! ```text
//!                 enable: owner, fresh setpoint, fresh states,
//!                 no fault, no latched cause, no jump              every motor ready
//!   Disarmed ──────────────────────────────────────────▶ Starting ──────────────────▶ Active
//!       ▲                                                    │                           │
//!       │ every joint at rest, or damped long enough         │ disable, release,         │
//!       └───────────────────────── Damping ◀─────────────────┴─── or a cause, latched ───┘
//! ```
//!
//! A latched cause is left by a reset and by nothing else.

use crate::joint::{Impedance, Joint};
use crate::settings::{GroupSettings, SafeStop};
use motord_bus::{Duration, Instant};
use motord_shared::limits::JOINTS_MAX;
use motord_shared::{
    Cause, GroupState, JointSetpoint, Lease, Phase, Rejection, SetpointMessage, SetpointMode,
};

/// A setpoint may be stamped this much later than the cycle's own reading of the clock.
const FUTURE_MAX: Duration = Duration::from_millis(1);
/// A sequence number may rise by this much at once; a larger step is a message that was never counted up.
const SEQUENCE_STEP_MAX: u64 = 1 << 32;

/// What a group is doing.
#[derive(Debug)]
pub(super) struct Group {
    pub(super) motors: Vec<usize>,
    pub(super) safe_stop: SafeStop,
    phase: Phase,
    /// When the phase began; damping begins anew when what was held is let go.
    since: Instant,
    /// Since when every joint has been at rest while damping.
    pub(super) resting_since: Option<Instant>,
    pub(super) owner: Option<Owner>,
    cause: Option<(Cause, Option<usize>)>,
    /// The stop under way holds until then, and damps after it.
    held_until: Option<Instant>,
    /// A motor told over-voltage: braking feeds the supply, so the group is damped less.
    pub(super) over_voltage: bool,
    setpoint: Option<Accepted>,
    accepted: u32,
    rejected: [u32; Rejection::COUNT],
}

/// Who owns a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Owner {
    pub(super) lease: Lease,
    pub(super) pid: u32,
    /// When it last gave a sign of life.
    pub(super) heard: Instant,
    /// The last sequence number accepted.
    sequence: u64,
}

impl Owner {
    pub(super) const fn new(lease: Lease, pid: u32, now: Instant) -> Self {
        Self { lease, pid, heard: now, sequence: 0 }
    }
}

/// The newest setpoint that passed every check.
#[derive(Debug, Clone, Copy)]
struct Accepted {
    /// When it was sent, or when it arrived if that was earlier.
    at: Instant,
    joints: [JointSetpoint; JOINTS_MAX],
}

impl Group {
    pub(super) fn new(settings: &GroupSettings) -> Self {
        Self {
            motors: settings.motors.clone(),
            safe_stop: settings.safe_stop,
            phase: Phase::Disarmed,
            since: Instant::ZERO,
            resting_since: None,
            owner: None,
            cause: None,
            held_until: None,
            over_voltage: false,
            setpoint: None,
            accepted: 0,
            rejected: [0; Rejection::COUNT],
        }
    }

    pub(super) const fn phase(&self) -> Phase {
        self.phase
    }

    pub(super) const fn since(&self) -> Instant {
        self.since
    }

    pub(super) fn enter(&mut self, phase: Phase, now: Instant) {
        self.phase = phase;
        self.since = now;
        self.resting_since = None;
        self.held_until = None;
    }

    /// Holds where it is, for so long, before it damps.
    pub(super) fn hold(&mut self, now: Instant, time: Duration) {
        self.held_until = Some(now + time);
    }

    pub(super) const fn is_held(&self) -> bool {
        self.held_until.is_some()
    }

    /// Lets go what is held when its time is over, or at once: it is damped from `now` on.
    pub(super) fn let_go(&mut self, now: Instant, at_once: bool) {
        if self.held_until.take_if(|until| at_once || *until <= now).is_some() {
            self.enter(Phase::Damping, now);
        }
    }

    pub(super) fn cause(&self) -> Option<Cause> {
        self.cause.map(|(cause, _)| cause)
    }

    /// Latches the first cause; later ones are consequences. An emergency stop is never hidden by another cause.
    pub(super) fn latch(&mut self, cause: Cause, motor: Option<usize>) -> bool {
        let latch = self.cause.is_none() || cause == Cause::EmergencyStop && self.cause() != Some(cause);
        if latch {
            self.cause = Some((cause, motor));
        }
        latch
    }

    pub(super) const fn reset(&mut self) {
        self.cause = None;
        self.over_voltage = false;
    }

    /// Takes `message` for the newest setpoint, or says why not. Bounded by the joints of one message.
    ///
    /// # Errors
    ///
    /// The first reason to reject it; it is counted, and what was accepted before stays.
    pub(super) fn offer(
        &mut self,
        message: &SetpointMessage,
        now: Instant,
        timeout: Duration,
        allows: impl Fn(usize, SetpointMode) -> bool,
    ) -> Result<(), Rejection> {
        let checked = self.check(message, now, timeout, allows);
        match checked {
            Ok(()) => {
                let sent = Instant::from_nanos(message.time_ns).min(now);
                self.setpoint = Some(Accepted { at: sent, joints: message.joints });
                if let Some(owner) = &mut self.owner {
                    owner.sequence = message.sequence;
                    owner.heard = now;
                }
                self.accepted = self.accepted.wrapping_add(1);
            }
            Err(rejection) => {
                let counter = &mut self.rejected[rejection.code() as usize];
                *counter = counter.wrapping_add(1);
            }
        }
        checked
    }

    fn check(
        &self,
        message: &SetpointMessage,
        now: Instant,
        timeout: Duration,
        allows: impl Fn(usize, SetpointMode) -> bool,
    ) -> Result<(), Rejection> {
        let sent = Instant::from_nanos(message.time_ns);
        let owner =
            self.owner.filter(|owner| owner.lease.raw() == message.lease).ok_or(Rejection::WrongLease)?;
        if message.joint_count as usize != self.motors.len() {
            return Err(Rejection::JointCount);
        }
        if !(1..=SEQUENCE_STEP_MAX).contains(&message.sequence.wrapping_sub(owner.sequence)) {
            return Err(Rejection::Sequence);
        }
        if sent > now + FUTURE_MAX {
            return Err(Rejection::FromFuture);
        }
        if now.since(sent) > timeout {
            return Err(Rejection::Stale);
        }
        self.motors
            .iter()
            .zip(&message.joints)
            .try_for_each(|(&motor, joint)| check_joint(joint, |mode| allows(motor, mode)))
    }

    /// Forgets the owner and what it asked for.
    pub(super) const fn forget_owner(&mut self) -> Option<Owner> {
        self.setpoint = None;
        self.owner.take()
    }

    /// The setpoint in use is not older than `timeout`.
    pub(super) fn has_fresh_setpoint(&self, now: Instant, timeout: Duration) -> bool {
        self.setpoint.as_ref().is_some_and(|setpoint| now.since(setpoint.at) <= timeout)
    }

    /// What the owner asks of the joint at `place` of the group.
    pub(super) fn wanted(&self, place: usize) -> Option<(Impedance<Joint>, SetpointMode)> {
        let joint = self.setpoint.as_ref()?.joints.get(place)?;
        let mode = SetpointMode::try_from(joint.mode).ok()?;
        let JointSetpoint { position, velocity, kp, kd, torque, .. } = *joint;
        Some((Impedance::new(position, velocity, kp, kd, torque), mode))
    }

    pub(super) fn setpoint_age(&self, now: Instant) -> Option<Duration> {
        self.setpoint.as_ref().map(|setpoint| now.since(setpoint.at))
    }

    pub(super) fn report(&self, now: Instant) -> GroupState {
        let age = self.setpoint_age(now).map_or(0, motord_bus::time::nanos);
        let (cause, joint) = self.cause.map_or((0, None), |(cause, joint)| (cause.code(), joint));
        GroupState {
            lease: self.owner.map_or(0, |owner| owner.lease.raw()),
            sequence: self.owner.map_or(0, |owner| owner.sequence),
            setpoint_age_ns: age,
            phase: self.phase.code(),
            cause,
            cause_joint: joint.map_or(u32::MAX, |joint| joint as u32),
            accepted: self.accepted,
            rejected: self.rejected,
        }
    }
}

fn check_joint(joint: &JointSetpoint, allows: impl Fn(SetpointMode) -> bool) -> Result<(), Rejection> {
    let JointSetpoint { position, velocity, kp, kd, torque, mode } = *joint;
    if !Impedance::<Joint>::new(position, velocity, kp, kd, torque).is_finite() {
        return Err(Rejection::NotFinite);
    }
    if kp < 0.0 || kd < 0.0 {
        return Err(Rejection::Negative);
    }
    match SetpointMode::try_from(mode) {
        Ok(mode) if allows(mode) => Ok(()),
        _ => Err(Rejection::Mode),
    }
}
