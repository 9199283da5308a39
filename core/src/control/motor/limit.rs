//! Limits: the last thing before the wire.
//!
//! Order: clamp (position, velocity, kp, kd, torque), start ramp, slew (position, kp, kd, torque),
//! a bound on
//! |kp·Δp + kd·Δv + torque|, temperature, and the heat of the winding. The limits that acted are reported bit by bit next to
//! the applied command.

use motord_protocol::drive::{Impedance, JointSide, Measured, Setpoint};
use motord_settings::settings::LimitSettings;
use motord_shared::{Limit, SetpointMode};

/// A command after all limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Applied {
    /// The command, as it may be sent.
    pub setpoint: Setpoint,
    /// `Limit::bit` of every limit that changed something.
    pub limits: u32,
}

impl Applied {
    /// No stiffness, no damping, no torque; no limit acted.
    pub const NEUTRAL: Self = Self { setpoint: Setpoint::NEUTRAL, limits: 0 };
}

/// Everything that the limits depend on besides the setpoint.
#[derive(Debug, Clone, Copy)]
pub struct Circumstances<'a> {
    /// The limits of the joint.
    pub limits: &'a LimitSettings,
    /// The command applied in the turn before.
    pub previous: &'a Impedance<JointSide>,
    /// The last state of the joint.
    pub measured: &'a Measured<JointSide>,
    /// Age of the state, s. Adds kp·abs(v)·age to the predicted torque that is bounded.
    pub age: f32,
    /// Time since the turn before, s.
    pub elapsed: f32,
    /// Progress of the start ramp, 0 to 1.
    pub ramp: f32,
    /// Torque that the winding may give at its present heat, N·m.
    pub winding_torque: f32,
}

/// Limits `wanted`. Pure, allocates nothing. Every value of `wanted` must be finite, as checked on
/// its arrival.
#[must_use]
#[inline(always)]
pub fn limit(wanted: &Setpoint, circumstances: &Circumstances<'_>) -> Applied {
    let mut limiter = Limiter::new(*wanted, circumstances.age);
    limiter.clamp(circumstances.limits);
    limiter.ramp(circumstances.ramp);
    limiter.slew(circumstances);
    limiter.bound(circumstances.limits.torque, circumstances.measured);
    limiter.derate(circumstances);
    // Rounding in the bounds before must not look like heat.
    if circumstances.winding_torque < circumstances.limits.torque {
        limiter.bound_to(Limit::Overload, circumstances.winding_torque, circumstances.measured);
    }
    limiter.applied()
}

/// A damping command whose torque stays within the joint's limit: braking a fast joint must not
/// break its gear.
#[must_use]
pub fn damp(kd: f32, limits: &LimitSettings, measured: Option<&Measured<JointSide>>) -> Applied {
    let damping = Setpoint::impedance(Impedance::new(0.0, 0.0, 0.0, kd, 0.0));
    let mut limiter = Limiter::new(damping, 0.0);
    if let Some(measured) = measured {
        limiter.bound(limits.torque, measured);
    }
    limiter.applied()
}

/// Takes the motion out of a joint whose drive has a speed loop of its own: a speed that falls from
/// that of the joint to zero.
///
/// The commanded speed is never higher than the joint's last known speed, nor against it, and falls
/// on without a new state: each such command brakes. Only the slope bounds the torque of the drive;
/// `share` is the part of the slope that is used.
#[must_use]
pub(super) fn brake(
    previous: &Setpoint,
    share: f32,
    limits: &LimitSettings,
    measured: Option<&Measured<JointSide>>,
    elapsed: f32,
) -> Applied {
    let turns = measured.map_or(0.0, |measured| measured.velocity);
    let begun = if previous.mode == SetpointMode::Speed { previous.values.velocity } else { turns };
    let slower = (begun.abs() - share * limits.velocity / SPEED_RISE * elapsed).max(0.0).copysign(begun);
    // Where one of the two values is NaN, `min` and `max` give the other.
    let [low, high] = [turns.min(0.0).max(-limits.velocity), turns.max(0.0).min(limits.velocity)];
    let speed = slower.max(low).min(high);
    let setpoint = Setpoint { values: Impedance::new(0.0, speed, 0.0, 0.0, 0.0), mode: SetpointMode::Speed };
    Limiter::new(setpoint, 0.0).applied()
}

/// Keeps a joint where it was held when the stop began, with the gains it had, but not damped less
/// than `kd`.
#[must_use]
pub(super) fn hold(
    held: Setpoint,
    kd: f32,
    limits: &LimitSettings,
    measured: &Measured<JointSide>,
    age: f32,
) -> Applied {
    let mut limiter = Limiter::new(held, age);
    limiter.value.kd = held.values.kd.max(kd);
    limiter.bound(limits.torque, measured);
    limiter.applied()
}

/// A speed setpoint rises from zero to the joint's limit in this time, s.
const SPEED_RISE: f32 = 0.5;

struct Limiter {
    value: Impedance<JointSide>,
    mode: SetpointMode,
    acted: u32,
    age: f32,
}

impl Limiter {
    const fn new(setpoint: Setpoint, age: f32) -> Self {
        Self { value: setpoint.values, mode: setpoint.mode, acted: 0, age }
    }

    const fn applied(&self) -> Applied {
        Applied { setpoint: Setpoint { values: self.value, mode: self.mode }, limits: self.acted }
    }

    #[inline(always)]
    fn clamp(&mut self, limits: &LimitSettings) {
        let Impedance { position, velocity, kp, kd, torque, .. } = self.value;
        let [low, high] = limits.position;
        self.value = Impedance::new(
            self.between(Limit::Position, position, low, high),
            self.around(Limit::Velocity, velocity, 0.0, limits.velocity),
            self.between(Limit::Kp, kp, 0.0, limits.kp),
            self.between(Limit::Kd, kd, 0.0, limits.kd),
            self.around(Limit::Torque, torque, 0.0, limits.torque),
        );
    }

    fn ramp(&mut self, ramp: f32) {
        if ramp < 1.0 {
            self.scale(Limit::StartRamp, ramp.max(0.0));
        }
    }

    #[inline(always)]
    fn slew(&mut self, circumstances: &Circumstances<'_>) {
        let Circumstances { limits, previous, elapsed, .. } = *circumstances;
        let Impedance { position, kp, kd, torque, .. } = self.value;
        self.value = Impedance::new(
            self.around(Limit::PositionSlew, position, previous.position, limits.velocity * elapsed),
            self.slewed_velocity(circumstances),
            self.around(Limit::KpSlew, kp, previous.kp, limits.kp_slew * elapsed),
            self.around(Limit::KdSlew, kd, previous.kd, limits.kd_slew * elapsed),
            self.around(Limit::TorqueSlew, torque, previous.torque, limits.torque_slew * elapsed),
        );
    }

    /// Less torque for a hot motor: linear from all at `temperature_derate` to nothing at
    /// `temperature`.
    fn derate(&mut self, circumstances: &Circumstances<'_>) {
        let Circumstances { limits, measured, .. } = *circumstances;
        let Some(temperature) = measured.temperature else { return };
        if temperature > limits.temperature_derate {
            let span = (limits.temperature - limits.temperature_derate).max(f32::MIN_POSITIVE);
            let share = ((limits.temperature - temperature) / span).clamp(0.0, 1.0);
            self.bound_to(Limit::Temperature, share * limits.torque, measured);
        }
    }

    /// A speed setpoint rises like a gain does, and does not lead out of the joint's range. In the
    /// other modes the velocity only feeds the damping forward.
    fn slewed_velocity(&mut self, circumstances: &Circumstances<'_>) -> f32 {
        let Circumstances { limits, previous, measured, elapsed, ramp, .. } = *circumstances;
        let velocity = self.value.velocity;
        if self.mode != SetpointMode::Speed {
            return velocity;
        }
        let [low, high] = limits.position;
        let upward = if measured.position < high { limits.velocity } else { 0.0 };
        let downward = if measured.position > low { limits.velocity } else { 0.0 };
        let within = self.between(Limit::Position, velocity, -downward, upward);
        let slewed =
            self.around(Limit::Velocity, within, previous.velocity, limits.velocity / SPEED_RISE * elapsed);
        self.around(Limit::StartRamp, slewed, 0.0, ramp * limits.velocity)
    }

    fn bound(&mut self, torque_max: f32, measured: &Measured<JointSide>) {
        self.bound_to(Limit::TotalTorque, torque_max, measured);
    }

    /// Scales stiffness, damping and torque together, so that their total keeps its sign and the
    /// shares of its parts.
    fn bound_to(&mut self, limit: Limit, torque_max: f32, measured: &Measured<JointSide>) {
        let Measured { position, velocity, .. } = *measured;
        let travelled = velocity.abs() * self.age;
        let predicted = self.value.predicted_torque(position, velocity).abs() + self.value.kp * travelled;
        if predicted > torque_max {
            self.scale(limit, torque_max / predicted);
        }
    }

    fn scale(&mut self, limit: Limit, factor: f32) {
        self.acted |= limit.bit();
        self.value.kp *= factor;
        self.value.kd *= factor;
        self.value.torque *= factor;
    }

    /// Not below `low`, and not above `high`.
    #[inline(always)]
    fn between(&mut self, limit: Limit, value: f32, low: f32, high: f32) -> f32 {
        if value >= low && value <= high {
            return value;
        }
        self.bounded(limit, value, low, high)
    }

    /// At most `most` away from `centre`.
    #[inline(always)]
    fn around(&mut self, limit: Limit, value: f32, centre: f32, most: f32) -> f32 {
        if (value - centre).abs() <= most {
            return value;
        }
        self.bounded(limit, value, centre - most, centre + most)
    }

    /// Returns the value within the bounds that is nearest to `value`. NaN becomes the lower bound.
    #[inline(always)]
    fn bounded(&mut self, limit: Limit, value: f32, low: f32, high: f32) -> f32 {
        let inside = nearest(value, low, high);
        self.acted |= if inside == value { 0 } else { limit.bit() };
        inside
    }
}

/// Cold: most setpoints are within the limits.
#[cold]
fn nearest(value: f32, low: f32, high: f32) -> f32 {
    let inside = if value > low { value } else { low };
    if inside < high { inside } else { high }
}
