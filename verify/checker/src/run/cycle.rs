//! The record of one cycle from outside. Its frames belong to it, however late they are on the
//! wire.

use crate::protocol::codec::Meaning;
use crate::state::{Joint, Phase, State};
use motord_bus::Instant;
use std::rc::Rc;

/// One cycle.
#[derive(Debug)]
pub(super) struct Cycle {
    /// The state that was published before it.
    pub(super) before: Rc<State>,
    /// The state that it published.
    pub(super) state: Rc<State>,
    pub(super) begun: Instant,
    /// Time since the previous cycle, as far as slews may count it, s.
    pub(super) elapsed: f64,
    /// Sum of all `elapsed`, s.
    pub(super) time: f64,
    /// By group: time of the owner's last message that is good in every respect, or the end of its
    /// horizon.
    pub(super) good_setpoint: Vec<Option<Instant>>,
    /// By group: an enable was requested, and nothing has stopped the group since.
    pub(super) enabled: Vec<bool>,
    /// By motor: its position when a stop could have begun, before and after the cycle's reply,
    /// rad.
    pub(super) held: Vec<[f64; 2]>,
    /// By bus: no fault keeps frames from the wire.
    pub(super) well: Vec<bool>,
    /// By motor: its command in this cycle. A fault request counts as one when the motor received
    /// nothing else.
    pub(super) received: Vec<Option<ReceivedCommand>>,
    /// Number of frames by bus.
    pub(super) frames: Vec<usize>,
}

impl Cycle {
    /// Returns `true` when the group was in this phase before and after the cycle.
    pub(super) fn is(&self, group: usize, phase: Phase) -> bool {
        self.was(group, phase) && self.state.groups[group].phase == phase
    }

    /// Returns `true` when the group was in this phase before the cycle.
    pub(super) fn was(&self, group: usize, phase: Phase) -> bool {
        self.before.groups[group].phase == phase
    }

    /// Returns `true` when the group was in this phase before or after the cycle.
    pub(super) fn touches(&self, group: usize, phase: Phase) -> bool {
        self.was(group, phase) || self.state.groups[group].phase == phase
    }
}

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
            // The input that it puts into effect was checked when it was sent.
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
