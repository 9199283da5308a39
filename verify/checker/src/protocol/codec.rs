//! The meaning of the frames of one protocol.

use super::ranges::Ranges;
use motord_bus::{Frame, FrameId};

/// The ids of a motor in a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ids {
    /// Its id.
    pub motor: u8,
    /// The id of its replies, where the protocol has one.
    pub reply: FrameId,
}

/// The sender of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sender {
    /// The host, to the motor.
    Host,
    /// The motor.
    Motor,
    /// One of them: a request and its answer may be equal.
    Either,
}

/// The meaning of the frames of one protocol.
pub(crate) trait Codec {
    /// Returns the sender of a frame to or from the motor with these ids; `None` for another frame.
    fn sender(&self, frame: &Frame, ids: &Ids) -> Option<Sender> {
        match frame.id() {
            id if id == FrameId::from(ids.motor) => Some(Sender::Host),
            id if id == ids.reply => Some(Sender::Motor),
            _ => None,
        }
    }

    /// Decodes a command to a motor, motor side.
    fn order(&self, frame: &Frame) -> Meaning;

    /// Decodes a reply of motor `id`, motor side. `None` when it does not contain the motion.
    fn reported(&self, frame: &Frame, id: u8) -> Option<Reported>;

    /// Checks a command by itself: some are forbidden, whatever was requested.
    ///
    /// # Panics
    ///
    /// When it is forbidden. Unless a protocol has other rules: when it is no command of a cycle.
    fn check(&self, frame: &Frame) {
        let meaning = self.order(frame);
        assert!(!matches!(meaning, Meaning::Other(_)), "I1: {frame:?} is {meaning:?}");
    }

    /// Returns the size of one code of each field of its impedances. `None` where a command has one
    /// value.
    fn codes(&self) -> Option<Ranges>;

    /// Returns `true` when a reply may contain a part of the state.
    fn reports_parts(&self) -> bool {
        false
    }

    /// Returns `true` when the motor has registers, which a request to 0x7FF reads.
    fn has_registers(&self) -> bool {
        false
    }
}

/// A command to a motor, as the motor decodes it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Meaning {
    /// Start following commands.
    Start,
    /// Go limp.
    Stop,
    /// Make the present position zero.
    SetZero,
    /// Read the fault number.
    GetFault,
    /// Clear the fault.
    ClearFault,
    /// Read an indicator.
    GetIndicator,
    /// Read one of the registers 21 to 23, in place of the command of a cycle.
    GetRegister,
    /// An impedance setpoint.
    Control {
        /// rad
        position: f64,
        /// rad/s
        velocity: f64,
        /// N·m/rad
        kp: f64,
        /// N·m·s/rad
        kd: f64,
        /// N·m
        torque: f64,
        /// Velocity and torque stand for zero, which may lie between two codes.
        neutral: bool,
    },
    /// Follow the inputs of another mode, which were sent before.
    Mode,
    /// Hold this torque, N·m.
    Torque(f64),
    /// Turn at this speed, rad/s.
    Speed(f64),
    /// Move to this position, rad.
    Position(f64),
    /// A command byte that a cycle never sends: it accesses the motor's memory, turns the shaft for
    /// a calibration, ends the firmware, or is not documented.
    Other(u8),
}

impl Meaning {
    /// Returns the command to the joint of a motor with this direction and this offset, rad, from
    /// that to the motor.
    pub(crate) fn on_joint(self, direction: f64, offset: f64) -> Self {
        match self {
            Self::Control { position, velocity, kp, kd, torque, neutral } => Self::Control {
                position: direction * position + offset,
                velocity: direction * velocity,
                kp,
                kd,
                torque: direction * torque,
                neutral,
            },
            Self::Torque(torque) => Self::Torque(direction * torque),
            Self::Speed(velocity) => Self::Speed(direction * velocity),
            Self::Position(position) => Self::Position(direction * position + offset),
            other => other,
        }
    }

    /// Returns `true` for a request in addition to the command of a cycle.
    pub(crate) const fn is_question(&self) -> bool {
        matches!(self, Self::GetFault | Self::GetIndicator)
    }
}

/// The motion of a motor, as a reply reports it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reported {
    /// Position, rad, and velocity, rad/s.
    State([f64; 2]),
    /// The position alone, rad.
    Angle(f64),
    /// The velocity alone, rad/s.
    Speed(f64),
}

/// Returns the eight bytes of a command in MIT and GIM.
///
/// # Panics
///
/// When they are not eight, or all zero.
pub(super) fn eight_bytes(frame: &Frame) -> [u8; 8] {
    let bytes = frame.payload().try_into().expect("every command has eight bytes");
    assert_ne!(bytes, [0; 8], "I1: the all-zero frame");
    bytes
}
