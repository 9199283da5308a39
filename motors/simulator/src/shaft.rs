//! The place and the speed of an output shaft.

/// The state of an output shaft, on the scale of [`MotorSettings::initial_position`](crate::MotorSettings::initial_position).
/// A set-zero command moves the motor's own zero, and not this one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Shaft {
    /// rad, unlimited.
    pub position: f64,
    /// rad/s.
    pub velocity: f64,
}
