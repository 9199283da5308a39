//! Position and speed of an output shaft.

/// The state of an output shaft, on the scale of
/// [`MotorSettings::initial_position`](crate::MotorSettings::initial_position). A set-zero command
/// changes the motor's own zero, and not this scale.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Shaft {
    /// rad, unlimited.
    pub position: f64,
    /// rad/s.
    pub velocity: f64,
}
