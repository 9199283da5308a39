//! The frames: commands to a drive, and what it sends by itself.

use crate::cansimple::frame::{word, words};
pub use crate::cansimple::{AxisState, ReportedState};
use crate::cansimple::{Estimates, Id};
use crate::fault::Faults;
#[cfg(any(feature = "drive", feature = "commissioning"))]
use motord_bus::{Frame, FrameId};

/// Number of bytes of every frame but [`Command::ClearErrors`].
const BYTES: usize = 8;
/// The input is used as it is.
const PASSTHROUGH: u32 = 1;

/// The numbers of the commands.
mod number {
    pub(super) const HEARTBEAT: u8 = 0x01;
    pub(super) const SET_STATE: u8 = 0x07;
    pub(super) const ESTIMATES: u8 = 0x09;
    pub(super) const SET_MODE: u8 = 0x0B;
    pub(super) const POSITION: u8 = 0x0C;
    pub(super) const VELOCITY: u8 = 0x0D;
    pub(super) const TORQUE: u8 = 0x0E;
    pub(super) const TEMPERATURES: u8 = 0x15;
    pub(super) const BUS: u8 = 0x17;
    pub(super) const CLEAR_ERRORS: u8 = 0x18;
    pub(super) const SET_POSITION: u8 = 0x19;
    pub(super) const TORQUES: u8 = 0x1C;
}

/// The quantity that the inputs of a drive control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ControlMode {
    /// The torque.
    Torque = 1,
    /// The velocity.
    Velocity = 2,
    /// The position.
    Position = 3,
}

/// A command to a drive. None is answered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// Enter this state (0x007).
    SetState(AxisState),
    /// Follow the inputs of this mode (0x00B).
    SetMode(ControlMode),
    /// Position of the rotor, turns (0x00C), without feed-forward.
    Position(f32),
    /// Velocity of the rotor, turns/s (0x00D), without feed-forward.
    Velocity(f32),
    /// Torque of the rotor, N·m (0x00E).
    Torque(f32),
    /// Clear all errors (0x018): one byte.
    ClearErrors,
    /// Make the present position zero, until the power is lost (0x019).
    SetZero,
}

impl Command {
    /// Returns the number of bytes of the payload.
    #[must_use]
    #[inline]
    pub const fn length(self) -> usize {
        match self {
            Self::ClearErrors => 1,
            _ => BYTES,
        }
    }

    /// Returns the command to `node` as a frame. `None` for a node above [`NODE_MAX`](super::NODE_MAX).
    #[cfg(any(feature = "drive", feature = "commissioning"))]
    #[inline]
    pub(super) fn frame(self, node: u8) -> Option<Frame> {
        let (id, payload) = self.encode(node);
        let id = FrameId::new(id.raw())?;
        Some(match self.length() {
            1 => Frame::classic(id, [payload[0]]),
            _ => Frame::classic(id, payload),
        })
    }

    /// Returns id and payload of the command to `node`. Of the payload, the first
    /// [`length`](Self::length) bytes are sent.
    #[must_use]
    #[inline]
    pub fn encode(self, node: u8) -> (Id, [u8; BYTES]) {
        let (command, payload) = match self {
            Self::SetState(state) => (number::SET_STATE, word(state as u32)),
            Self::SetMode(mode) => (number::SET_MODE, words([mode as u32, PASSTHROUGH])),
            Self::Position(turns) => (number::POSITION, word(turns.to_bits())),
            Self::Velocity(turns) => (number::VELOCITY, word(turns.to_bits())),
            Self::Torque(torque) => (number::TORQUE, word(torque.to_bits())),
            Self::ClearErrors => (number::CLEAR_ERRORS, word(0)),
            Self::SetZero => (number::SET_POSITION, word(0)),
        };
        (Id { node, command }, payload)
    }
}

/// The report of the axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Heartbeat {
    /// Its active errors, as bits.
    pub errors: u32,
    /// Its state.
    pub state: ReportedState,
}

/// A frame that a drive sends by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reply {
    /// The axis (0x001).
    Heartbeat(Heartbeat),
    /// The encoder (0x009).
    Estimates(Estimates),
    /// Temperature of the motor, °C (0x015). NaN without a sensor.
    Temperature(f32),
    /// The supply (0x017).
    Bus {
        /// V.
        volts: f32,
        /// A. It may be any number.
        amperes: f32,
    },
    /// Estimated torque of the rotor, N·m (0x01C).
    Torque(f32),
}

impl Reply {
    /// Decodes a frame with this `id` and classic `payload`. `None` for another frame, and for estimates,
    /// a voltage and a torque that are not finite.
    #[must_use]
    #[inline]
    pub fn decode(id: Id, payload: &[u8]) -> Option<Self> {
        let payload: [u8; BYTES] = payload.try_into().ok()?;
        let [a, b, c, d, e, f, g, h] = payload;
        let [first, second] = [[a, b, c, d], [e, f, g, h]].map(f32::from_le_bytes);
        match id.command {
            number::HEARTBEAT => {
                let errors = u32::from_le_bytes([a, b, c, d]);
                Some(Self::Heartbeat(Heartbeat { errors, state: ReportedState(e) }))
            }
            number::TEMPERATURES => Some(Self::Temperature(second)),
            number::ESTIMATES if first.is_finite() && second.is_finite() => {
                Some(Self::Estimates(Estimates { position: first, velocity: second }))
            }
            number::BUS if first.is_finite() => Some(Self::Bus { volts: first, amperes: second }),
            number::TORQUES if second.is_finite() => Some(Self::Torque(second)),
            _ => None,
        }
    }
}

/// A drive that boots; it is ready soon.
const INITIALIZING: u32 = 1 << 0;

/// Bits of the errors: `ODriveError` of `odrive_enums.h`.
const ERRORS: [(u64, Faults); 13] = [
    (1 << 1, Faults::SOFTWARE),
    (1 << 2, Faults::FOC_FREQUENCY),
    (1 << 3, Faults::ENCODER),
    (1 << 5, Faults::DRIVER_CHIP),
    (1 << 8, Faults::OVER_VOLTAGE),
    (1 << 9, Faults::UNDER_VOLTAGE),
    (1 << 10, Faults::OVER_CURRENT),
    (1 << 11, Faults::OVER_CURRENT),
    (1 << 12, Faults::OVER_CURRENT),
    (1 << 13, Faults::MOTOR_OVER_TEMPERATURE),
    (1 << 14, Faults::DRIVER_OVER_TEMPERATURE),
    (1 << 24, Faults::HOST_SILENT),
    // The encoder reports a motion that the motor cannot have.
    (1 << 26, Faults::ENCODER),
];

/// Returns the faults of these active errors. Of the bits without a name, the lowest is reported by its
/// index.
#[must_use]
pub fn faults(errors: u32) -> Faults {
    Faults::of_bits(&ERRORS, (errors & !INITIALIZING).into())
}
