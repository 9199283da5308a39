//! The orders of a group to one of its motors.

use motord_protocol::drive::Setpoint;

/// The orders of a group to one of its motors in a cycle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GroupCommand {
    /// The newest setpoint of the joint.
    pub(crate) wanted: Option<Setpoint>,
    /// Progress of the start ramp, 0 to 1 and beyond.
    pub(crate) ramp: f32,
    /// The stop under way holds.
    pub(crate) held: bool,
    /// A motor of the group reported over-voltage: braking feeds the supply, so it is damped less.
    pub(crate) over_voltage: bool,
}
