//! Setpoint messages: checked as a whole when they arrive.

use super::{Group, Owner};
use crate::control::context::Context;
use motord_bus::{Duration, Instant};
use motord_protocol::drive::{Impedance, JointSide, Setpoint};
use motord_settings::settings::{MotorSettings, SafetySettings};
use motord_shared::{JointSetpoint, Phase, Rejection, SetpointMessage, SetpointMode};

/// A setpoint may be stamped this much later than the cycle's reading of the clock.
const FUTURE_MAX: Duration = Duration::from_millis(1);
/// Largest step of a sequence number. A larger one is an arbitrary number.
const SEQUENCE_STEP_MAX: u64 = 1 << 32;

impl Group {
    /// Takes the setpoints of `message` before a cycle decides, or counts the reason of the
    /// rejection. `cx` is that of the previous cycle. Does not allocate; bounded by the joints of
    /// one message.
    pub(crate) fn offer(&mut self, message: &SetpointMessage, now: Instant, cx: &Context) {
        match self.check(message, now, &cx.safety) {
            Ok(()) => self.accept(message, now, cx),
            Err(rejection) => {
                let counter = &mut self.rejected[rejection.code() as usize];
                *counter = counter.wrapping_add(1);
            }
        }
    }

    fn accept(&mut self, message: &SetpointMessage, now: Instant, cx: &Context) {
        let before = cx.wake.cycle;
        // Motors that follow nothing yet have no way to go.
        let is_active = self.phase == Phase::Active;
        let horizon = Duration::from_nanos(if is_active { message.horizon_ns.into() } else { 0 });
        if !horizon.is_zero() {
            self.begin_interpolation(message, now);
        }
        let Self { setpoints, owner, accepted, late, .. } = self;
        setpoints.begin_interpolation(cx.now, horizon);
        setpoints.answered = if message.cycle > before { 0 } else { message.cycle };
        setpoints.used = 0;
        let is_late = setpoints.answered > 0 && setpoints.answered < before;
        *late = late.wrapping_add(u32::from(is_late));
        setpoints.sent(Instant::from_nanos(message.time_ns).min(now));
        for (slot, joint) in message.joints.iter().enumerate().take(self.motors.len()) {
            setpoints.set_target(slot, setpoint(joint));
        }
        if let Some(owner) = owner {
            owner.sequence = message.sequence;
            owner.last_seen = now;
        }
        *accepted = accepted.wrapping_add(1);
    }

    /// Notes where each joint begins its way to the setpoints of `message`.
    #[cold]
    fn begin_interpolation(&mut self, message: &SetpointMessage, now: Instant) {
        let share = self.setpoints.share(now);
        for (slot, (motor, joint)) in self.motors.iter().zip(&message.joints).enumerate() {
            let origin = motor.interpolation_origin(self.setpoints.get(slot, share), setpoint(joint));
            self.setpoints.set_origin(slot, origin);
        }
    }

    fn check(
        &self,
        message: &SetpointMessage,
        now: Instant,
        safety: &SafetySettings,
    ) -> Result<(), Rejection> {
        let sent = Instant::from_nanos(message.time_ns);
        let is_owner = |owner: &Owner| owner.lease.raw() == message.lease;
        let owner = self.owner.filter(is_owner).ok_or(Rejection::WrongLease)?;
        if message.joint_count as usize != self.motors.len() {
            return Err(Rejection::JointCount);
        }
        if !(1..=SEQUENCE_STEP_MAX).contains(&message.sequence.wrapping_sub(owner.sequence)) {
            return Err(Rejection::Sequence);
        }
        if sent > now + FUTURE_MAX {
            return Err(Rejection::FromFuture);
        }
        if now.since(sent) > safety.setpoint_timeout {
            return Err(Rejection::Stale);
        }
        if Duration::from_nanos(message.horizon_ns.into()) > safety.setpoint_horizon_max {
            return Err(Rejection::Horizon);
        }
        let mut joints = self.motors.iter().zip(&message.joints);
        joints.try_for_each(|(motor, joint)| match check_joint(joint, &motor.settings) {
            // The owner cannot know the position of a joint whose motor is excluded.
            Err(_) if motor.is_excluded() => Ok(()),
            outcome => outcome,
        })
    }
}

fn check_joint(joint: &JointSetpoint, motor: &MotorSettings) -> Result<(), Rejection> {
    if !values(joint).is_finite() {
        return Err(Rejection::NotFinite);
    }
    if joint.kp < 0.0 || joint.kd < 0.0 {
        return Err(Rejection::Negative);
    }
    match SetpointMode::try_from(joint.mode) {
        Ok(mode) if motor.accepts(mode) => Ok(()),
        _ => Err(Rejection::Mode),
    }
}

/// Returns the setpoint of a joint that passed [`check_joint`]. An excluded joint may have failed,
/// but its setpoint is not used.
fn setpoint(joint: &JointSetpoint) -> Setpoint {
    let mode = SetpointMode::try_from(joint.mode).unwrap_or(SetpointMode::Impedance);
    Setpoint { values: values(joint), mode }
}

const fn values(joint: &JointSetpoint) -> Impedance<JointSide> {
    let JointSetpoint { position, velocity, kp, kd, torque, .. } = *joint;
    Impedance::new(position, velocity, kp, kd, torque)
}
