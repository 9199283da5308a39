//! The codes of a control frame and of a state. All have 16 bits.

use crate::field::Field;
use crate::scale::Scales;

/// Number of bits of each code.
const BITS: u32 = 16;

/// Encoding of one motor's quantities, in both directions. It has the ends of the motor's
/// [`Scales`], and finer steps: the protocol's ranges are those of MIT.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WideScales {
    /// Position of the output shaft, rad.
    pub position: Field,
    /// Velocity of the output shaft, rad/s.
    pub velocity: Field,
    /// Stiffness, N·m/rad.
    pub kp: Field,
    /// Damping, N·m·s/rad.
    pub kd: Field,
    /// Torque at the output shaft, N·m.
    pub torque: Field,
}

impl WideScales {
    /// Returns the scales with the ends of these ones.
    #[must_use]
    pub const fn of(scales: &Scales) -> Self {
        let ends = scales.ends();
        Self {
            position: Field::symmetric(BITS, ends.position),
            velocity: Field::symmetric(BITS, ends.velocity),
            kp: Field::new(BITS, 0.0, ends.kp),
            kd: Field::new(BITS, 0.0, ends.kd),
            torque: Field::symmetric(BITS, ends.torque),
        }
    }
}

/// The codes of a control frame: the torque in its id, then those of its payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ControlCodes {
    /// Torque, see [`WideScales::torque`].
    pub torque: u16,
    /// Position, see [`WideScales::position`].
    pub position: u16,
    /// Velocity, see [`WideScales::velocity`].
    pub velocity: u16,
    /// Stiffness, see [`WideScales::kp`].
    pub kp: u16,
    /// Damping, see [`WideScales::kd`].
    pub kd: u16,
}

impl ControlCodes {
    /// Returns the nearest codes to position, rad, velocity, rad/s, stiffness, N·m/rad, damping,
    /// N·m·s/rad, and torque, N·m, after clamping. `None` where a value is not finite.
    #[must_use]
    pub fn nearest([position, velocity, kp, kd, torque]: [f32; 5], scales: &WideScales) -> Option<Self> {
        Some(Self {
            torque: scales.torque.encode(torque.into())?,
            position: scales.position.encode(position.into())?,
            velocity: scales.velocity.encode(velocity.into())?,
            kp: scales.kp.encode(kp.into())?,
            kd: scales.kd.encode(kd.into())?,
        })
    }

    /// Returns the payload.
    pub(super) fn payload(self) -> [u8; 8] {
        let Self { position, velocity, kp, kd, .. } = self;
        let [[a, b], [c, d], [e, f], [g, h]] = [position, velocity, kp, kd].map(u16::to_be_bytes);
        [a, b, c, d, e, f, g, h]
    }
}
