//! The first motion of a joint: by 2° and back, softly.

use crate::failure::DirectFailure;
use crate::guard::StopOnDrop;
use crate::motion::{Jogged, PERIOD};
use crate::target::{Protocol, Session};
use motord_protocol::commissioning::Error;
use motord_terminal::Interrupt;
use std::time::{Duration, Instant};

/// The distance, rad: 2°.
const DISTANCE: f64 = 0.035;
/// Beyond this distance the motor is stopped, rad: 8°.
pub(super) const TRAVEL_MAX: f64 = 0.14;
/// Against its command the motor is stopped beyond this distance, rad: 1°.
const AGAINST_MAX: f64 = 0.0175;
/// Speed of the reference that pulls the joint, rad/s.
const RATE: f64 = 0.1;
/// Above this speed the motor is stopped, rad/s.
const SPEED_MAX: f64 = 2.0;
/// The joint may be this far outside of its limits during the motion, rad: a hand has written them.
const OUTSIDE_MAX: f64 = 0.01;
/// Largest torque that pulls the joint, N·m, where its limit is not lower.
const TORQUE_MAX: f64 = 3.0;
/// Stiffness of a motor in MIT mode, N·m/rad.
const KP: f64 = 30.0;
/// Damping of a motor in MIT mode, N·m·s/rad.
const KD: f64 = 1.0;
/// The joint is back within this distance, rad.
const BACK: f64 = 0.01;
/// Longest time to move by [`DISTANCE`], or back.
const TRAVEL_TIME_MAX: Duration = Duration::from_secs(2);

/// Returns the largest torque, N·m, of the first motion of a joint.
pub(super) fn torque_max(session: &Session) -> f64 {
    let limit = session.settings.as_ref().map_or(TORQUE_MAX, |motor| f64::from(motor.limits.torque));
    limit.min(TORQUE_MAX)
}

/// Moves the joint by 2° and back, and stops its motor. `sign` is the direction of the motor: 1 or
/// -1. Returns the largest distance, rad, in the direction of `sign`.
///
/// The pull grows slowly until the joint moves. In MIT mode its stiffness pulls with at most
/// [`torque_max`]. In native mode the motor follows a speed of at most 0.3 rad/s, and is stopped
/// when it reports more torque.
///
/// # Errors
///
/// [`DirectFailure::Unfit`] when the joint does not move or come back, moves against its command,
/// too far, too fast or out of its limits, or when its stop is not confirmed;
/// [`Error::Interrupted`]; the motor does not answer. The motor is stopped in all cases.
pub(super) fn move_a_little(
    session: &mut Session,
    sign: f64,
    interrupt: &Interrupt,
) -> Result<f64, DirectFailure> {
    let (torque, allowed) = (torque_max(session), session.allowed());
    let held = |what| format!("does not {what} with {torque:.1} N·m: free it, and check that it is not held");
    let mut motor = StopOnDrop::new(Jogged::new(session, KD as f32));
    let begin = motor.start()?;
    let mut pull = Pull { begin, sign, torque, allowed, at: 0.0, reference: 0.0, farthest: 0.0 };
    if !pull.travel(&mut motor, RATE, interrupt, |at| at >= DISTANCE)? {
        return Err(pull.unfit(&motor, &held("move by 2°")));
    }
    if !pull.travel(&mut motor, -RATE, interrupt, |at| at <= BACK)? {
        return Err(pull.unfit(&motor, &held("come back")));
    }
    let id = motor.id();
    motor.stop().map_err(|error| DirectFailure::Unfit {
        id,
        reason: format!("its stop is not confirmed: cut the power of the motor ({error})"),
    })?;
    Ok(pull.farthest)
}

/// The motion so far, rad, in the direction of `sign`.
struct Pull {
    /// Position of the motor at the begin.
    begin: f64,
    sign: f64,
    /// Largest torque, N·m.
    torque: f64,
    /// Positions of the motor within the limits of the joint, rad.
    allowed: [f64; 2],
    at: f64,
    reference: f64,
    farthest: f64,
}

impl Pull {
    /// Moves the reference at `rate`, rad/s, until the joint is where `is_there` says. `false` when
    /// the time for one way is over before.
    fn travel(
        &mut self,
        motor: &mut Jogged<'_>,
        rate: f64,
        interrupt: &Interrupt,
        is_there: impl Fn(f64) -> bool,
    ) -> Result<bool, DirectFailure> {
        self.reference = self.at;
        let until = Instant::now() + TRAVEL_TIME_MAX;
        while !is_there(self.at) {
            if Instant::now() > until {
                return Ok(false);
            }
            self.step(motor, rate, interrupt)?;
        }
        Ok(true)
    }

    /// Moves the reference by one period, and pulls the joint to it.
    fn step(
        &mut self,
        motor: &mut Jogged<'_>,
        rate: f64,
        interrupt: &Interrupt,
    ) -> Result<(), DirectFailure> {
        if interrupt.is_raised() {
            return Err(Error::Interrupted.into());
        }
        let lead = self.lead(rate, motor.protocol());
        // A motor in native mode follows a speed: the faster, the farther its reference leads.
        let velocity = (lead * 4.0).clamp(-3.0 * RATE, 3.0 * RATE);
        let target = self.begin + self.sign * self.reference;
        let [position, speed, torque] = motor.pull(target, self.sign * velocity, KP as f32)?;
        self.at = (position - self.begin) * self.sign;
        self.farthest = self.farthest.max(self.at);
        let torque = if motor.protocol() == Protocol::Gim { torque } else { 0.0 };
        if let Some(reason) = self.exceeded(position, speed, torque) {
            return Err(self.unfit(motor, reason));
        }
        interrupt.pause_until(Instant::now() + PERIOD);
        Ok(())
    }

    /// Moves the reference by one period. Returns by how much it leads, rad.
    fn lead(&mut self, rate: f64, protocol: Protocol) -> f64 {
        // In MIT mode the lead is the torque.
        let torque = if protocol == Protocol::Mit { self.torque } else { TORQUE_MAX };
        let most = torque / KP;
        let next = self.reference + rate * PERIOD.as_secs_f64();
        self.reference = next.clamp(self.at - most, self.at + most);
        self.reference - self.at
    }

    /// Returns why the motor must be stopped, for its `position`, rad, `speed`, rad/s, and the
    /// `torque`, N·m, that it takes.
    fn exceeded(&self, position: f64, speed: f64, torque: f64) -> Option<&'static str> {
        let [low, high] = self.allowed;
        let [low, high] = [low.min(self.begin) - OUTSIDE_MAX, high.max(self.begin) + OUTSIDE_MAX];
        if self.at < -AGAINST_MAX {
            return Some(
                "turns against its command: cut its power, then check the order of its phases (`motorctl calibrate phase`)",
            );
        }
        if torque.abs() > self.torque {
            return Some(
                "needs more torque than 3 N·m or its limit, and was stopped: is it held, loaded or its torque-nm too low?",
            );
        }
        if !(low..=high).contains(&position) {
            return Some("left its limits, and was stopped: is it loaded or unbalanced?");
        }
        let is_beyond = self.at > TRAVEL_MAX || speed.abs() > SPEED_MAX;
        is_beyond.then_some("moved too far or too fast, and was stopped: is it loaded or unbalanced?")
    }

    fn unfit(&self, motor: &Jogged<'_>, what: &str) -> DirectFailure {
        let degrees = self.at.to_degrees();
        DirectFailure::Unfit {
            id: motor.id(),
            reason: format!("the joint {what} (it turned by {degrees:.1}°)"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pull(torque: f64) -> Pull {
        Pull { begin: 0.0, sign: 1.0, torque, allowed: [-0.1, 0.1], at: 0.0, reference: 0.0, farthest: 0.0 }
    }

    #[test]
    fn stiffness_pulls_within_torque_limit() {
        for rate in [RATE, -RATE] {
            let mut pull = pull(0.2);
            let largest = (0..500).map(|_| (KP * pull.lead(rate, Protocol::Mit)).abs()).fold(0.0, f64::max);
            assert!((0.19..=0.2 + 1e-9).contains(&largest), "{largest}");
        }
    }

    #[test]
    fn motion_beyond_bounds_is_stopped() {
        let pull = pull(0.2);
        assert_eq!(pull.exceeded(0.05, 0.1, 0.2), None);
        for (position, speed, torque) in
            [(0.05, 0.1, -0.21), (0.05, 2.1, 0.0), (0.12, 0.1, 0.0), (-0.12, 0.1, 0.0)]
        {
            assert!(pull.exceeded(position, speed, torque).is_some(), "{position} {speed} {torque}");
        }
    }
}
