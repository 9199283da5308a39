//! The two views of a joint: the robot's, and the drive's.
//!
//! Both sides have the same units, so the type distinguishes them. Only [`Transmission`] converts
//! between them:
//!
//! ```compile_fail
//! # use motord_protocol::drive::{Impedance, JointSide, MotorSide};
//! let wanted: Impedance<JointSide> = Impedance::NEUTRAL;
//! let sent: Impedance<MotorSide> = wanted;
//! ```
//!
//! ```
//! # use motord_protocol::drive::{Impedance, MotorSide, Transmission};
//! let sent: Impedance<MotorSide> = Transmission::new(-1.0, 0.5).to_motor(&Impedance::NEUTRAL);
//! ```

use crate::Field;
use core::marker::PhantomData;
use motord_shared::SetpointMode;

/// The robot's side: sign and zero as the controllers know them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointSide {}

/// The drive's side: sign and zero as they are on the wire. Both sides are after the gear.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotorSide {}

/// The control law of a drive: torque = `kp`·(position − p) + `kd`·(velocity − v) + `torque`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Impedance<Side> {
    /// rad.
    pub position: f32,
    /// rad/s.
    pub velocity: f32,
    /// Stiffness, N·m/rad.
    pub kp: f32,
    /// Damping, N·m·s/rad.
    pub kd: f32,
    /// N·m.
    pub torque: f32,
    side: PhantomData<Side>,
}

impl<Side> Impedance<Side> {
    /// No stiffness, no damping, no torque.
    pub const NEUTRAL: Self = Self::new(0.0, 0.0, 0.0, 0.0, 0.0);

    /// Units as in the fields.
    #[must_use]
    pub const fn new(position: f32, velocity: f32, kp: f32, kd: f32, torque: f32) -> Self {
        Self { position, velocity, kp, kd, torque, side: PhantomData }
    }

    /// Returns the torque at `position` and `velocity` of the joint, N·m.
    #[must_use]
    pub fn predicted_torque(&self, position: f32, velocity: f32) -> f32 {
        self.kp * (self.position - position) + self.kd * (self.velocity - velocity) + self.torque
    }

    /// Returns whether every value is a finite number.
    #[must_use]
    #[inline]
    pub fn is_finite(&self) -> bool {
        // Nothing times a finite number is zero, and times any other it is NaN.
        let zero = |value: f32| 0.0 * value;
        let [a, b, c, d, e] = [self.position, self.velocity, self.kp, self.kd, self.torque].map(zero);
        a + b + c + d + e == 0.0
    }
}

/// A setpoint or an applied command of one joint: values and mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setpoint {
    /// The values. A mode other than impedance uses those that it needs.
    pub values: Impedance<JointSide>,
    /// The meaning of the values.
    pub mode: SetpointMode,
}

impl Setpoint {
    /// No stiffness, no damping, no torque.
    pub const NEUTRAL: Self = Self::impedance(Impedance::NEUTRAL);

    /// In impedance mode.
    #[must_use]
    pub const fn impedance(values: Impedance<JointSide>) -> Self {
        Self { values, mode: SetpointMode::Impedance }
    }

    /// Returns whether it pulls the joint to its position. Stiffness has no effect in torque and
    /// speed mode.
    #[must_use]
    #[inline]
    pub fn pulls(&self) -> bool {
        // No `match`: a jump by a table costs more than the rest of the check.
        let is_position = matches!(self.mode, SetpointMode::Position);
        matches!(self.mode, SetpointMode::Impedance) && self.values.kp > 0.0 || is_position
    }
}

/// A report of a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured<Side> {
    /// rad.
    pub position: f32,
    /// rad/s.
    pub velocity: f32,
    /// N·m.
    pub torque: f32,
    /// °C, where the protocol reports it.
    pub temperature: Option<f32>,
    side: PhantomData<Side>,
}

impl<Side> Measured<Side> {
    /// Units as in the fields.
    #[must_use]
    pub const fn new(position: f32, velocity: f32, torque: f32, temperature: Option<f32>) -> Self {
        Self { position, velocity, torque, temperature, side: PhantomData }
    }
}

/// The way a joint is mounted on its motor: joint angle = direction · motor angle + offset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transmission {
    direction: f32,
    offset: f32,
}

impl Transmission {
    /// `direction` is +1 or -1, `offset` in rad.
    #[must_use]
    pub const fn new(direction: f32, offset: f32) -> Self {
        Self { direction, offset }
    }

    /// +1, or -1 where the joint turns against its motor.
    #[must_use]
    pub const fn direction(&self) -> f32 {
        self.direction
    }

    /// Joint angle at the motor's zero, rad.
    #[must_use]
    pub const fn offset(&self) -> f32 {
        self.offset
    }

    /// Position of the motor, rad, at this position of the joint, rad.
    #[must_use]
    #[inline]
    pub fn position_to_motor(&self, joint: f32) -> f32 {
        self.direction * (joint - self.offset)
    }

    /// Position of the joint, rad, at this position of the motor, rad.
    #[must_use]
    #[inline]
    pub fn position_to_joint(&self, motor: f32) -> f32 {
        self.direction * motor + self.offset
    }

    /// Converts a command for the joint to one for the motor.
    #[must_use]
    #[inline]
    pub fn to_motor(&self, joint: &Impedance<JointSide>) -> Impedance<MotorSide> {
        Impedance::new(
            self.position_to_motor(joint.position),
            self.direction * joint.velocity,
            joint.kp,
            joint.kd,
            self.direction * joint.torque,
        )
    }

    /// Converts a state of the motor to that of the joint.
    #[must_use]
    #[inline]
    pub fn to_joint(&self, motor: &Measured<MotorSide>) -> Measured<JointSide> {
        Measured::new(
            self.position_to_joint(motor.position),
            self.direction * motor.velocity,
            self.direction * motor.torque,
            motor.temperature,
        )
    }
}

/// Follows a position whose code wraps round. The turns are counted from accepted states only.
#[derive(Debug)]
pub(crate) struct Unwrap {
    /// The span of all position codes, rad: a position that leaves the range comes back this far
    /// away.
    period: f32,
    turns: f32,
    last: Option<f32>,
}

impl Unwrap {
    /// Of positions with these codes.
    pub(crate) fn new(position: Field) -> Self {
        let codes = f64::from(position.code_max()) + 1.0;
        Self { period: (codes * position.step()) as f32, turns: 0.0, last: None }
    }

    /// Returns the position as a code within its range reports it, rad.
    pub(crate) fn wrapped(&self, position: f32) -> f32 {
        (position + self.period / 2.0).rem_euclid(self.period) - self.period / 2.0
    }

    /// Returns the position over any number of turns, rad. A step of more than half the range is a
    /// wrap.
    pub(crate) fn position(&mut self, reported: f32) -> f32 {
        let step = reported - self.last.unwrap_or(reported);
        if step.abs() > self.period / 2.0 {
            self.turns -= step.signum();
        }
        self.last = Some(reported);
        reported + self.turns * self.period
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reversed_joint_has_equal_torque_on_both_sides() {
        let transmission = Transmission::new(-1.0, 0.3);
        let motor = Measured::<MotorSide>::new(0.8, -2.0, 1.5, None);
        let joint = transmission.to_joint(&motor);
        let wanted = Impedance::<JointSide>::new(0.1, 1.0, 40.0, 2.0, -3.0);
        let sent = transmission.to_motor(&wanted);

        let on_joint = wanted.predicted_torque(joint.position, joint.velocity);
        let on_motor = sent.predicted_torque(motor.position, motor.velocity);
        assert!(
            (on_joint + on_motor).abs() < 1e-4,
            "{on_joint} on the joint is {on_motor} on its reversed motor"
        );
        assert!(
            (joint.torque * joint.velocity - motor.torque * motor.velocity).abs() < 1e-6,
            "power is kept"
        );
    }

    #[test]
    fn a_position_that_wraps_goes_on() {
        let mut unwrap = Unwrap::new(Field::symmetric(16, 12.5));
        let turn = unwrap.period;
        let mut turned = 0.0_f32;
        for _ in 0..1000 {
            turned += 0.11;
            let reported = (turned + turn / 2.0).rem_euclid(turn) - turn / 2.0;
            assert!((unwrap.position(reported) - turned).abs() < 1e-3, "at {turned}");
        }
    }
}
