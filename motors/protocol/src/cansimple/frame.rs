//! The frames: commands to a driver, and its replies and reports.

use super::NODE_MAX;
use crate::mit::ControlCodes;
use crate::state::StateCodes;

/// Number of bytes of every command, and of every reply but that to an impedance.
const BYTES: usize = 8;
/// Bits of an id below the node.
const COMMAND_BITS: u16 = 5;
/// Position control with the input of MIT frames.
const MODE: [u32; 2] = [3, 9];
/// Selects the errors of the motor in a request for errors.
const OF_MOTOR: u8 = 0;

/// The numbers of the commands.
mod number {
    pub(super) const HEARTBEAT: u8 = 0x01;
    pub(super) const ERRORS: u8 = 0x03;
    pub(super) const SET_NODE: u8 = 0x06;
    pub(super) const SET_STATE: u8 = 0x07;
    pub(super) const CONTROL: u8 = 0x08;
    pub(super) const ESTIMATES: u8 = 0x09;
    pub(super) const SET_MODE: u8 = 0x0B;
    pub(super) const BUS: u8 = 0x17;
    pub(super) const CLEAR_ERRORS: u8 = 0x18;
    pub(super) const SET_COUNT: u8 = 0x19;
    pub(super) const SAVE: u8 = 0x1F;
}

/// An id of 11 bits, by its parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Id {
    /// The driver, 0 to 63.
    pub node: u8,
    /// The command, 0 to 31.
    pub command: u8,
}

impl Id {
    /// Splits the lower 11 bits of an id.
    #[must_use]
    #[inline]
    pub const fn of(raw: u32) -> Self {
        Self { node: (raw >> COMMAND_BITS) as u8 & NODE_MAX, command: raw as u8 & 0x1F }
    }

    /// Returns the number of 11 bits.
    #[must_use]
    #[inline]
    pub const fn raw(self) -> u16 {
        (self.node as u16 & NODE_MAX as u16) << COMMAND_BITS | self.command as u16 & 0x1F
    }
}

/// A state of the axis that motord requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AxisState {
    /// Disabled.
    Idle = 1,
    /// Enabled.
    ClosedLoop = 8,
}

/// The state of the axis in a heartbeat: 1 idle, 8 closed loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReportedState(pub u8);

impl ReportedState {
    /// Returns whether the axis follows commands.
    #[must_use]
    pub const fn is_running(self) -> bool {
        self.0 == AxisState::ClosedLoop as u8
    }

    /// Returns whether the axis is disabled. A driver that boots reports 0.
    #[must_use]
    pub const fn is_idle(self) -> bool {
        self.0 <= AxisState::Idle as u8
    }
}

/// A command to a driver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// Report the errors of the motor (0x003).
    GetErrors,
    /// Take this node id (0x006).
    SetNode(u8),
    /// Enter this state (0x007).
    SetState(AxisState),
    /// Follow an impedance (0x008). Answered by [`Reply::State`].
    Control(ControlCodes),
    /// Report the estimates of the encoder (0x009). The payload is that of the vendor's SDK. Only for a
    /// driver that does not send them by itself: frames of one id from two senders destroy each other.
    GetEstimates,
    /// Accept [`Control`](Self::Control): position control with the input of MIT frames (0x00B).
    SetMode,
    /// Report voltage and current of the supply (0x017).
    GetBus,
    /// Clear all errors (0x018).
    ClearErrors,
    /// Make the present position zero (0x019).
    SetZero,
    /// Store the configuration without power (0x01F). Never sent to a driver that is not known.
    Save,
}

impl Command {
    /// Returns id and payload of the command to `node`.
    #[must_use]
    #[inline]
    pub fn encode(self, node: u8) -> (Id, [u8; BYTES]) {
        let (command, payload) = self.parts();
        (Id { node, command }, payload)
    }

    #[inline]
    fn parts(self) -> (u8, [u8; BYTES]) {
        match self {
            Self::Control(codes) => (number::CONTROL, codes.pack()),
            Self::GetEstimates => (number::ESTIMATES, [0; BYTES]),
            Self::GetErrors => (number::ERRORS, word(OF_MOTOR.into())),
            Self::SetNode(node) => (number::SET_NODE, word(node.into())),
            Self::SetState(state) => (number::SET_STATE, word(state as u32)),
            Self::SetMode => (number::SET_MODE, words(MODE)),
            Self::GetBus => (number::BUS, [0; BYTES]),
            Self::ClearErrors => (number::CLEAR_ERRORS, [0; BYTES]),
            Self::SetZero => (number::SET_COUNT, [0; BYTES]),
            Self::Save => (number::SAVE, [0; BYTES]),
        }
    }
}

/// Returns the payload of one number.
pub(crate) const fn word(value: u32) -> [u8; BYTES] {
    words([value, 0])
}

/// Returns the payload of two numbers.
pub(crate) const fn words([low, high]: [u32; 2]) -> [u8; BYTES] {
    (low as u64 | (high as u64) << 32).to_le_bytes()
}

/// The report that a driver sends by itself, every 100 ms from the factory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Heartbeat {
    /// Errors of the axis, as bits.
    pub axis_errors: u32,
    /// The state of the axis.
    pub state: ReportedState,
    /// The motor has an error.
    pub motor_failed: bool,
    /// The encoder has an error.
    pub encoder_failed: bool,
}

/// The estimates of the encoder, at the rotor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimates {
    /// Turns.
    pub position: f32,
    /// Turns/s.
    pub velocity: f32,
}

impl Estimates {
    /// Returns position, rad, and velocity, rad/s, behind a gear of this ratio.
    #[must_use]
    #[inline]
    pub fn at_output(self, gear_ratio: f32) -> [f32; 2] {
        [self.position, self.velocity].map(|turns| turns * core::f32::consts::TAU / gear_ratio)
    }
}

/// A frame that a driver sends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reply {
    /// Unasked (0x001).
    Heartbeat(Heartbeat),
    /// The errors of the motor, as bits (0x003).
    Errors(u64),
    /// The answer to an impedance (0x008).
    State(StateCodes),
    /// The encoder, asked or not (0x009).
    Estimates(Estimates),
    /// Voltage, V, and current, A, of the supply (0x017).
    Bus {
        /// V.
        volts: f32,
        /// A.
        amperes: f32,
    },
}

impl Reply {
    /// Decodes a frame with this `id` and classic `payload`. `None` for a frame that no driver sends,
    /// and for a number that is not finite.
    #[must_use]
    #[inline]
    pub fn decode(id: Id, payload: &[u8]) -> Option<Self> {
        if let (number::CONTROL, &[node, a, b, c, d, e]) = (id.command, payload) {
            let state = StateCodes::unpack([a, b, c, d, e]);
            return (node == id.node).then_some(Self::State(state));
        }
        let payload: [u8; BYTES] = payload.try_into().ok()?;
        let [a, b, c, d, state, motor, encoder, _] = payload;
        match id.command {
            number::HEARTBEAT => Some(Self::Heartbeat(Heartbeat {
                axis_errors: u32::from_le_bytes([a, b, c, d]),
                state: ReportedState(state),
                motor_failed: motor != 0,
                encoder_failed: encoder != 0,
            })),
            number::ERRORS => Some(Self::Errors(u64::from_le_bytes(payload))),
            number::ESTIMATES => {
                let [position, velocity] = floats(payload)?;
                Some(Self::Estimates(Estimates { position, velocity }))
            }
            number::BUS => {
                let [volts, amperes] = floats(payload)?;
                Some(Self::Bus { volts, amperes })
            }
            _ => None,
        }
    }
}

/// Returns the two numbers of a payload, if both are finite.
#[inline]
fn floats([a, b, c, d, e, f, g, h]: [u8; BYTES]) -> Option<[f32; 2]> {
    let values = [[a, b, c, d], [e, f, g, h]].map(f32::from_le_bytes);
    values.iter().all(|value| value.is_finite()).then_some(values)
}
