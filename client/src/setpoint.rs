//! The setpoint of a joint.

use motord_shared::{JointSetpoint, Rejection, SetpointMode};

/// The setpoint of a joint in one cycle. The motor's torque is
/// `kp · (position - p) + kd · (velocity - v) + torque`, within the limits of the joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setpoint {
    /// rad.
    pub position: f32,
    /// rad/s.
    pub velocity: f32,
    /// Stiffness, N·m/rad, not negative.
    pub kp: f32,
    /// Damping, N·m·s/rad, not negative.
    pub kd: f32,
    /// N·m.
    pub torque: f32,
    /// The control mode. All motors support impedance; the other modes need a motor with the native
    /// protocol. For a native motor the daemon computes the impedance from states of the previous
    /// turn. Gains that suit an MIT motor may make it oscillate.
    pub mode: SetpointMode,
}

impl Setpoint {
    /// Follows `position` and `velocity` with a stiffness and a damping, and adds `torque`.
    #[must_use]
    pub const fn impedance(position: f32, velocity: f32, kp: f32, kd: f32, torque: f32) -> Self {
        Self { position, velocity, kp, kd, torque, mode: SetpointMode::Impedance }
    }

    /// Holds `position`, rad, with the stiffness `kp`, N·m/rad, and the damping `kd`, N·m·s/rad.
    #[must_use]
    pub const fn hold(position: f32, kp: f32, kd: f32) -> Self {
        Self::impedance(position, 0.0, kp, kd, 0.0)
    }

    /// Applies a torque, N·m, without stiffness or damping.
    #[must_use]
    pub const fn torque(torque: f32) -> Self {
        Self::impedance(0.0, 0.0, 0.0, 0.0, torque)
    }

    /// Resists every motion with a damping, N·m·s/rad.
    #[must_use]
    pub const fn damping(kd: f32) -> Self {
        Self::impedance(0.0, 0.0, 0.0, kd, 0.0)
    }

    /// Applies a torque, N·m, of a motor with the native protocol.
    #[must_use]
    pub const fn torque_only(torque: f32) -> Self {
        Self { torque, mode: SetpointMode::Torque, ..Self::torque(0.0) }
    }

    /// Sets the speed, rad/s, of a motor with the native protocol.
    #[must_use]
    pub const fn speed_only(velocity: f32) -> Self {
        Self { velocity, mode: SetpointMode::Speed, ..Self::torque(0.0) }
    }

    /// Sets the position, rad, of a motor with the native protocol.
    #[must_use]
    pub const fn position_only(position: f32) -> Self {
        Self { position, mode: SetpointMode::Position, ..Self::torque(0.0) }
    }

    /// Returns the reason why the daemon would reject these values.
    pub(crate) fn rejection(&self) -> Option<Rejection> {
        let Self { position, velocity, kp, kd, torque, .. } = *self;
        match [position, velocity, kp, kd, torque].iter().all(|value| value.is_finite()) {
            false => Some(Rejection::NotFinite),
            true => (kp < 0.0 || kd < 0.0).then_some(Rejection::Negative),
        }
    }
}

impl From<Setpoint> for JointSetpoint {
    fn from(setpoint: Setpoint) -> Self {
        let Setpoint { position, velocity, kp, kd, torque, mode } = setpoint;
        Self { position, velocity, kp, kd, torque, mode: mode.code() }
    }
}

impl From<&JointSetpoint> for Setpoint {
    /// Treats an unknown code as impedance. A client never sends one.
    fn from(setpoint: &JointSetpoint) -> Self {
        let JointSetpoint { position, velocity, kp, kd, torque, mode } = *setpoint;
        let mode = SetpointMode::try_from(mode).unwrap_or(SetpointMode::Impedance);
        Self { position, velocity, kp, kd, torque, mode }
    }
}
