//! The effect of a command to one motor, in any protocol.

use crate::protocol::codec::Meaning;
use crate::state::{Joint, State};

/// Margins for single precision: share by which a braking speed may exceed that of the joint, and
/// torque, N·m, that counts as zero.
const MARGIN: f64 = 1e-3;

/// A command that a motor received, classified by the known state of its joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ReceivedCommand {
    pub(super) order: Meaning,
    /// It brakes, and may also hold the joint.
    pub(super) brakes: bool,
    /// It pulls the joint to a position.
    pub(super) pulls: bool,
    /// It has no stiffness, no driving torque and no driving speed: it brakes at most.
    pub(super) is_safe: bool,
}

impl ReceivedCommand {
    /// Classifies `order`, which the motor with this index received between these states.
    pub(super) fn of(order: Meaning, index: usize, states: [&State; 2]) -> Self {
        let joints = states.map(|state| &state.joints[index]);
        let (brakes, pulls, is_safe) = match order {
            Meaning::Stop
            | Meaning::GetFault
            | Meaning::ClearFault
            | Meaning::GetIndicator
            | Meaning::GetRegister => (false, false, true),
            // The input that it puts into effect was judged when it was sent.
            Meaning::Mode => (true, false, true),
            Meaning::Start | Meaning::SetZero | Meaning::Other(_) => (false, false, false),
            Meaning::Control { kp, kd, neutral, .. } => (kd > 0.0, kp > 0.0, kp == 0.0 && neutral),
            Meaning::Position(_) => (true, true, false),
            Meaning::Torque(torque) => (false, false, torque.abs() <= MARGIN),
            Meaning::Speed(speed) => {
                let brakes = joints.iter().any(|joint| brakes(speed, joint));
                (brakes, false, brakes)
            }
        };
        Self { order, brakes, pulls, is_safe }
    }

    /// Returns `true` for a fault request, which replaces a command to a motor that does not reply.
    pub(super) fn is_fault_request(&self) -> bool {
        self.order == Meaning::GetFault
    }
}

/// Returns `true` when a drive that follows this speed, rad/s, brakes its joint: the joint turns
/// neither faster nor backward. Where the velocity is not known, only a speed of zero brakes.
fn brakes(speed: f64, joint: &Joint) -> bool {
    let velocity = f64::from(joint.velocity);
    speed == 0.0 || speed * velocity > 0.0 && speed.abs() <= velocity.abs() * (1.0 + MARGIN)
}
