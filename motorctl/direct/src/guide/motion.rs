//! The first motion of a joint: by 2° and back, softly.

use crate::failure::DirectFailure;
use crate::guard::StopOnDrop;
use crate::motion::{Jogged, PERIOD};
use crate::target::Session;
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
/// Largest torque that pulls the joint, N·m, where its limit is not lower.
const TORQUE_MAX: f64 = 3.0;
/// Stiffness of a motor in MIT mode, N·m/rad.
const KP: f64 = 30.0;
/// Damping of a motor in MIT mode, N·m·s/rad.
const KD: f64 = 1.0;
/// The joint is back within this distance, rad.
const BACK: f64 = 0.01;
/// Longest time for the way back.
const BACK_MAX: Duration = Duration::from_secs(2);

/// Moves the joint by 2° and back, and stops its motor. `sign` is the direction of the motor: 1 or
/// -1. The pull grows slowly, up to 3 N·m or the limit of the joint, until the joint moves. Returns
/// the largest distance, rad, in the direction of `sign`.
///
/// # Errors
///
/// [`DirectFailure::Unfit`] when the joint does not move, moves against its command, too far or too
/// fast; [`Error::Interrupted`]; the motor does not answer. The motor is stopped in all cases.
pub(super) fn move_a_little(
    session: &mut Session,
    sign: f64,
    interrupt: &Interrupt,
) -> Result<f64, DirectFailure> {
    let torque = session.settings.as_ref().map_or(TORQUE_MAX, |motor| f64::from(motor.limits.torque));
    let lead_max = (torque.min(TORQUE_MAX) / KP).max(DISTANCE / 2.0);
    let mut motor = StopOnDrop::new(Jogged::new(session, KD as f32));
    let mut pull = Pull { begin: motor.start()?, sign, at: 0.0, reference: 0.0, farthest: 0.0 };
    while pull.at < DISTANCE {
        if pull.reference - pull.at > lead_max {
            return Err(pull.unfit(&motor, "does not move: free it, and check that it is not held"));
        }
        pull.step(&mut motor, RATE, interrupt)?;
    }
    pull.reference = pull.at;
    let until = Instant::now() + BACK_MAX;
    while pull.at > BACK && Instant::now() < until {
        let rate = if pull.reference > -BACK { -RATE } else { 0.0 };
        pull.step(&mut motor, rate, interrupt)?;
    }
    motor.stop()?;
    Ok(pull.farthest)
}

/// The motion so far, rad, in the direction of `sign`.
struct Pull {
    /// Position of the motor at the begin.
    begin: f64,
    sign: f64,
    at: f64,
    reference: f64,
    farthest: f64,
}

impl Pull {
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
        self.reference += rate * PERIOD.as_secs_f64();
        // A motor in native mode follows a speed: the faster, the farther its reference leads.
        let velocity = ((self.reference - self.at) * 4.0).clamp(-3.0 * RATE, 3.0 * RATE);
        let target = self.begin + self.sign * self.reference;
        let [position, speed] = motor.pull(target, self.sign * velocity, KP as f32)?;
        self.at = (position - self.begin) * self.sign;
        self.farthest = self.farthest.max(self.at);
        if self.at < -AGAINST_MAX {
            return Err(self.unfit(
                motor,
                "turns against its command: cut its power, then check the order of its phases (`motorctl calibrate phase`)",
            ));
        }
        if self.at > TRAVEL_MAX || speed.abs() > SPEED_MAX {
            return Err(
                self.unfit(motor, "moved too far or too fast, and was stopped: is it loaded or unbalanced?")
            );
        }
        interrupt.pause_until(Instant::now() + PERIOD);
        Ok(())
    }

    fn unfit(&self, motor: &Jogged<'_>, what: &str) -> DirectFailure {
        let degrees = self.at.to_degrees();
        DirectFailure::Unfit {
            id: motor.id(),
            reason: format!("the joint {what} (it turned by {degrees:.1}°)"),
        }
    }
}
