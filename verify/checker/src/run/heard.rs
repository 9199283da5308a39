//! A command to one motor, for its joint, in any protocol.

use crate::codec;
use crate::gim;
use crate::robot::{Motor, Protocol};
use crate::state::{Joint, State};

/// Margins for single precision: share by which a braking speed may exceed that of the joint, and
/// torque, N·m, that counts as zero.
const MARGIN: f64 = 1e-3;

/// The command, with values on the side of the joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Order {
    Start,
    Stop,
    SetZero,
    GetFault,
    ClearFault,
    GetIndicator,
    /// A read of one of the registers 21 to 23, in place of the command.
    GetRegister,
    /// MIT: an impedance. Velocity and torque are `neutral` when both stand for zero, which lies
    /// between two codes.
    Impedance {
        position: f64,
        velocity: f64,
        kp: f64,
        kd: f64,
        torque: f64,
        neutral: bool,
    },
    /// Native: a torque.
    Torque(f64),
    /// Native: a speed.
    Speed(f64),
    /// Native: a position.
    Position(f64),
    /// Native: a command byte that a cycle never sends.
    Other(u8),
}

impl Order {
    /// Decodes the payload of a command to `motor`, which has eight bytes.
    pub(super) fn of(payload: &[u8], motor: &Motor) -> Self {
        let bytes = payload.try_into().expect("every command has eight bytes");
        match &motor.protocol {
            Protocol::Mit { ranges, .. } => Self::of_mit(codec::Meaning::of(bytes, ranges), motor),
            Protocol::Native => Self::of_native(gim::Meaning::of(bytes), motor),
        }
    }

    fn of_mit(meaning: codec::Meaning, &Motor { direction, offset, .. }: &Motor) -> Self {
        use codec::Meaning;
        match meaning {
            Meaning::Start => Self::Start,
            Meaning::Stop => Self::Stop,
            Meaning::SetZero => Self::SetZero,
            Meaning::GetFault => Self::GetFault,
            Meaning::ClearFault => Self::ClearFault,
            Meaning::Control { position, velocity, kp, kd, torque, neutral } => Self::Impedance {
                position: direction * position + offset,
                velocity: direction * velocity,
                kp,
                kd,
                torque: direction * torque,
                neutral,
            },
        }
    }

    fn of_native(meaning: gim::Meaning, &Motor { direction, offset, .. }: &Motor) -> Self {
        use gim::Meaning;
        match meaning {
            Meaning::Start => Self::Start,
            Meaning::Stop => Self::Stop,
            Meaning::GetFault => Self::GetFault,
            Meaning::ClearFault => Self::ClearFault,
            Meaning::GetIndicator => Self::GetIndicator,
            Meaning::Torque(torque) => Self::Torque(direction * torque),
            Meaning::Speed(velocity) => Self::Speed(direction * velocity),
            Meaning::Position(position) => Self::Position(direction * position + offset),
            Meaning::Other(command) => Self::Other(command),
        }
    }

    /// Returns `true` for a request in addition to the command of a cycle.
    pub(super) const fn is_question(&self) -> bool {
        matches!(self, Self::GetFault | Self::GetIndicator)
    }
}

/// A command that a motor received, classified by the known state of its joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Heard {
    pub(super) order: Order,
    /// It brakes, and may also hold the joint.
    pub(super) brakes: bool,
    /// It pulls the joint to a position.
    pub(super) pulls: bool,
    /// It has no stiffness, no driving torque and no driving speed: it brakes at most.
    pub(super) is_safe: bool,
}

impl Heard {
    /// Classifies `order`, which the motor with this index received between these states.
    pub(super) fn of(order: Order, index: usize, states: [&State; 2]) -> Self {
        let joints = states.map(|state| &state.joints[index]);
        let (brakes, pulls, is_safe) = match order {
            Order::Stop | Order::GetFault | Order::ClearFault | Order::GetIndicator | Order::GetRegister => {
                (false, false, true)
            }
            Order::Start | Order::SetZero | Order::Other(_) => (false, false, false),
            Order::Impedance { kp, kd, neutral, .. } => (kd > 0.0, kp > 0.0, kp == 0.0 && neutral),
            Order::Position(_) => (true, true, false),
            Order::Torque(torque) => (false, false, torque.abs() <= MARGIN),
            Order::Speed(speed) => {
                let brakes = joints.iter().any(|joint| brakes(speed, joint));
                (brakes, false, brakes)
            }
        };
        Self { order, brakes, pulls, is_safe }
    }

    /// Returns `true` for a fault request, which replaces a command to a motor that does not reply.
    pub(super) fn asks_fault(&self) -> bool {
        self.order == Order::GetFault
    }
}

/// Returns `true` when a drive that follows this speed, rad/s, brakes its joint: the joint turns
/// neither faster nor backward. Where the velocity is not known, only a speed of zero brakes.
fn brakes(speed: f64, joint: &Joint) -> bool {
    let velocity = f64::from(joint.velocity);
    speed == 0.0 || speed * velocity > 0.0 && speed.abs() <= velocity.abs() * (1.0 + MARGIN)
}
