//! The effect of a command to one motor, in any protocol.

use crate::protocol::codec::DecodedCommand;
use crate::state::{Joint, State};

/// Margins for single precision: share by which a braking speed may exceed that of the joint, and
/// torque, N·m, that counts as zero.
const MARGIN: f64 = 1e-3;

/// A command that a motor received, classified by the known state of its joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ReceivedCommand {
    pub(super) order: DecodedCommand,
    /// It brakes, and may also hold the joint.
    pub(super) brakes: bool,
    /// It pulls the joint to a position.
    pub(super) pulls: bool,
    /// It has no stiffness, no driving torque and no driving speed: it brakes at most.
    pub(super) is_safe: bool,
}

impl ReceivedCommand {
    /// Classifies `order`, which the motor with this index received between these states.
    pub(super) fn of(order: DecodedCommand, index: usize, states: [&State; 2]) -> Self {
        let joints = states.map(|state| &state.joints[index]);
        let (brakes, pulls, is_safe) = match order {
            DecodedCommand::Stop
            | DecodedCommand::GetFault
            | DecodedCommand::ClearFault
            | DecodedCommand::GetIndicator
            | DecodedCommand::GetRegister => (false, false, true),
            DecodedCommand::Start | DecodedCommand::SetZero | DecodedCommand::Other(_) => {
                (false, false, false)
            }
            DecodedCommand::Impedance { kp, kd, neutral, .. } => (kd > 0.0, kp > 0.0, kp == 0.0 && neutral),
            DecodedCommand::Position(_) => (true, true, false),
            DecodedCommand::Torque(torque) => (false, false, torque.abs() <= MARGIN),
            DecodedCommand::Speed(speed) => {
                let brakes = joints.iter().any(|joint| brakes(speed, joint));
                (brakes, false, brakes)
            }
        };
        Self { order, brakes, pulls, is_safe }
    }

    /// Returns `true` for a fault request, which replaces a command to a motor that does not reply.
    pub(super) fn is_fault_request(&self) -> bool {
        self.order == DecodedCommand::GetFault
    }
}

/// Returns `true` when a drive that follows this speed, rad/s, brakes its joint: the joint turns
/// neither faster nor backward. Where the velocity is not known, only a speed of zero brakes.
fn brakes(speed: f64, joint: &Joint) -> bool {
    let velocity = f64::from(joint.velocity);
    speed == 0.0 || speed * velocity > 0.0 && speed.abs() <= velocity.abs() * (1.0 + MARGIN)
}
