//! The record of a cycle of the joint.

/// The command that the motor had, joint side, after all limits.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Applied {
    /// rad.
    pub position: f64,
    /// rad/s.
    pub velocity: f64,
    /// Stiffness, N·m/rad.
    pub kp: f64,
    /// Damping, N·m·s/rad.
    pub kd: f64,
    /// N·m.
    pub torque: f64,
}

/// The answer of the motor to one command.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sample {
    /// When the command was sent, s, on any clock that does not jump. The state is younger by a
    /// part of `latency`.
    pub time: f64,
    /// Time from the command to the answer, s.
    pub latency: f64,
    /// rad.
    pub position: f64,
    /// Torque as the motor reports it, N·m.
    pub torque: f64,
    /// The command that it answered.
    pub applied: Applied,
}
