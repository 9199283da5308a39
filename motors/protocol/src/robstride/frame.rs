//! The frames: commands to a motor, and its replies.

use super::codes::{ControlCodes, WideScales};
use crate::fault::Faults;

/// Number of bytes of every payload.
const BYTES: usize = 8;
/// The payload of commands that change a setting begins with these bytes; the setting follows.
const SETTING: [u8; 6] = [1, 2, 3, 4, 5, 6];
/// First byte of a stop that also clears the faults, and of a zero.
const DO: u8 = 1;
/// The payload of a request for the version begins with these bytes, as does that of its answer,
/// which has a third one.
const VERSION: [u8; 3] = [0x00, 0xC4, 0x56];
/// Target of the answer to a request for the id.
const ANY_HOST: u8 = 0xFE;

/// The types of frames.
mod kind {
    pub(super) const DEVICE: u8 = 0;
    pub(super) const CONTROL: u8 = 1;
    pub(super) const FEEDBACK: u8 = 2;
    pub(super) const ENABLE: u8 = 3;
    pub(super) const STOP: u8 = 4;
    pub(super) const SET_ZERO: u8 = 6;
    pub(super) const SET_ID: u8 = 7;
    pub(super) const READ: u8 = 17;
    pub(super) const WRITE: u8 = 18;
    pub(super) const FAULTS: u8 = 21;
    pub(super) const SAVE: u8 = 22;
    pub(super) const REPORT: u8 = 24;
    pub(super) const SET_PROTOCOL: u8 = 25;
}

/// An id of 29 bits, by its parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Id {
    /// The type of the frame, 5 bits.
    pub kind: u8,
    /// Bits 8 to 23.
    pub data: u16,
    /// The id of the receiver.
    pub target: u8,
}

impl Id {
    /// Splits the lower 29 bits of an id.
    #[must_use]
    pub const fn of(raw: u32) -> Self {
        Self { kind: (raw >> 24) as u8 & 0x1F, data: (raw >> 8) as u16, target: raw as u8 }
    }

    /// Returns the number of 29 bits.
    #[must_use]
    pub const fn raw(self) -> u32 {
        (self.kind as u32 & 0x1F) << 24 | (self.data as u32) << 8 | self.target as u32
    }
}

/// A command to a motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Report the id and the serial number (type 0). Does not move or change the motor.
    GetDevice,
    /// Follow an impedance (type 1).
    Control(ControlCodes),
    /// Enable the drive (type 3).
    Enable,
    /// Disable the drive (type 4).
    Stop,
    /// Disable the drive, and clear its faults (type 4).
    ClearFault,
    /// Disable the drive, and report the version of its firmware (type 4).
    GetVersion,
    /// Make the present position zero (type 6).
    SetZero,
    /// Take this id, immediately (type 7).
    SetId(u8),
    /// Report the parameter with this index (type 17).
    Read(u16),
    /// Set the parameter with this index to these bytes, until the power is lost (type 18).
    Write(u16, [u8; 4]),
    /// Store the parameters without power (type 22).
    Save,
    /// Send the state unasked, or no longer (type 24).
    SetReport(bool),
    /// Speak the protocol with this number from the next power-on: 0 is this one, 2 is MIT (type
    /// 25).
    SetProtocol(u8),
}

impl Command {
    /// Returns id and payload of the command from `host` to `motor`.
    #[must_use]
    #[inline]
    pub fn encode(self, motor: u8, host: u8) -> (Id, [u8; BYTES]) {
        let (kind, data, payload) = self.parts();
        let data = if kind == kind::CONTROL { data } else { data | u16::from(host) };
        (Id { kind, data, target: motor }, payload)
    }

    /// Returns the type, the data without the host's id, and the payload.
    fn parts(self) -> (u8, u16, [u8; BYTES]) {
        match self {
            Self::GetDevice => (kind::DEVICE, 0, [0; BYTES]),
            Self::Control(codes) => (kind::CONTROL, codes.torque, codes.payload()),
            Self::Enable => (kind::ENABLE, 0, [0; BYTES]),
            Self::Stop => (kind::STOP, 0, [0; BYTES]),
            Self::ClearFault => (kind::STOP, 0, first(DO)),
            Self::GetVersion => (kind::STOP, 0, [VERSION[0], VERSION[1], 0, 0, 0, 0, 0, 0]),
            Self::SetZero => (kind::SET_ZERO, 0, first(DO)),
            Self::SetId(id) => (kind::SET_ID, u16::from(id) << 8, [0; BYTES]),
            Self::Read(index) => (kind::READ, 0, parameter(index, [0; 4])),
            Self::Write(index, value) => (kind::WRITE, 0, parameter(index, value)),
            Self::Save => (kind::SAVE, 0, setting(0x07, 0x08)),
            Self::SetReport(on) => (kind::REPORT, 0, setting(u8::from(on), 0)),
            Self::SetProtocol(number) => (kind::SET_PROTOCOL, 0, setting(number, 0)),
        }
    }
}

const fn first(byte: u8) -> [u8; BYTES] {
    [byte, 0, 0, 0, 0, 0, 0, 0]
}

const fn setting(value: u8, last: u8) -> [u8; BYTES] {
    let [a, b, c, d, e, f] = SETTING;
    [a, b, c, d, e, f, value, last]
}

const fn parameter(index: u16, [a, b, c, d]: [u8; 4]) -> [u8; BYTES] {
    let [low, high] = index.to_le_bytes();
    [low, high, 0, 0, a, b, c, d]
}

/// The mode that a state reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Disabled.
    Reset,
    /// It measures itself, and may turn the shaft.
    Calibration,
    /// Enabled.
    Run,
    /// The number that no document lists.
    Unknown,
}

/// The state of a motor, as codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Feedback {
    /// Bits 16 to 21 of the id: the faults.
    pub fault_bits: u8,
    /// Bits 22 and 23 of the id.
    pub mode: Mode,
    /// Position, see [`WideScales::position`].
    pub position: u16,
    /// Velocity, see [`WideScales::velocity`].
    pub velocity: u16,
    /// Torque, see [`WideScales::torque`].
    pub torque: u16,
    /// Temperature of the winding, 0.1 °C. The documents do not state its sign: a code above 32767
    /// is read as frost, because no motor is so hot.
    pub temperature: i16,
}

impl Feedback {
    fn of(data: u16, payload: [u8; BYTES]) -> Self {
        let status = (data >> 8) as u8;
        let [a, b, c, d, e, f, g, h] = payload;
        Self {
            fault_bits: status & 0x3F,
            mode: match status >> 6 {
                0 => Mode::Reset,
                1 => Mode::Calibration,
                2 => Mode::Run,
                _ => Mode::Unknown,
            },
            position: u16::from_be_bytes([a, b]),
            velocity: u16::from_be_bytes([c, d]),
            torque: u16::from_be_bytes([e, f]),
            temperature: i16::from_be_bytes([g, h]),
        }
    }

    /// Returns position, rad, velocity, rad/s, and torque, N·m, at the output shaft of a motor with
    /// these scales.
    #[must_use]
    #[inline]
    pub fn scaled(&self, scales: &WideScales) -> [f32; 3] {
        let values = [
            scales.position.decode(self.position),
            scales.velocity.decode(self.velocity),
            scales.torque.decode(self.torque),
        ];
        values.map(|value| value as f32)
    }

    /// Returns the temperature of the winding, °C.
    #[must_use]
    pub fn celsius(&self) -> f32 {
        f32::from(self.temperature) / 10.0
    }

    /// Returns whether the motor reports that it is enabled. The mode without a meaning counts as
    /// enabled, because the motor may be.
    #[must_use]
    pub const fn is_on(&self) -> bool {
        matches!(self.mode, Mode::Run | Mode::Unknown)
    }

    /// Returns the faults. Bit 20 of a CyberGear's id is the fault of its Hall encoder.
    #[must_use]
    #[inline]
    pub fn faults(&self) -> Faults {
        if self.fault_bits == 0 { Faults::NONE } else { faults(&FEEDBACK_FAULTS, self.fault_bits.into()).0 }
    }
}

/// The faults of a state, by the bits from 16 on of its id.
const FEEDBACK_FAULTS: [(u32, Faults); 6] = [
    (1 << 0, Faults::UNDER_VOLTAGE),
    (1 << 1, Faults::OVER_CURRENT),
    (1 << 2, Faults::OVER_TEMPERATURE),
    (1 << 3, Faults::ENCODER),
    (1 << 4, Faults::OVERLOAD),
    // Not calibrated: the sentence of this fault includes it.
    (1 << 5, Faults::ENCODER),
];

/// The faults of a report (type 21).
const REPORT_FAULTS: [(u32, Faults); 11] = [
    (1 << 0, Faults::OVER_TEMPERATURE),
    (1 << 1, Faults::DRIVER_CHIP),
    (1 << 2, Faults::UNDER_VOLTAGE),
    (1 << 3, Faults::OVER_VOLTAGE),
    (1 << 4, Faults::OVER_CURRENT),
    (1 << 5, Faults::OVER_CURRENT),
    (1 << 7, Faults::ENCODER),
    (1 << 8, Faults::HARDWARE),
    (1 << 9, Faults::POSITION),
    (1 << 14, Faults::OVERLOAD),
    (1 << 16, Faults::OVER_CURRENT),
];

/// Returns the faults of `number` by a table, and the bits that the table does not have.
fn faults(table: &[(u32, Faults)], number: u32) -> (Faults, u32) {
    let known = table.iter().filter(|(bit, _)| number & bit != 0);
    known.fold((Faults::NONE, number), |(all, rest), (bit, fault)| (all.and(*fault), rest & !bit))
}

/// Returns the faults of the number in a fault report. Of the bits without a name, the lowest is
/// reported by its index.
#[must_use]
pub fn faults_of_report(number: u32) -> Faults {
    let (faults, rest) = faults(&REPORT_FAULTS, number);
    if rest == 0 { faults } else { faults.and(Faults::of_unknown_code(rest.trailing_zeros() as u8)) }
}

/// A frame that a motor sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reply {
    /// Its serial number (type 0).
    Device([u8; 8]),
    /// Its state (type 2).
    Feedback(Feedback),
    /// Its state, unasked (type 24).
    Report(Feedback),
    /// The version of its firmware: four numbers (type 2).
    Version([u8; 4]),
    /// A parameter: its index, and its value unless the motor refuses (type 17).
    Parameter(u16, Option<[u8; 4]>),
    /// Numbers of its faults and its warnings, unasked (type 21).
    Faults {
        /// Bits, see [`faults_of_report`].
        faults: u32,
        /// Bits; 0 is a hot winding, some degrees below the fault.
        warnings: u32,
    },
}

impl Reply {
    /// Decodes a frame with this `id` and classic `payload`. Returns the motor's id and the content;
    /// `None` for a frame that no motor sends.
    #[must_use]
    #[inline]
    pub fn decode(id: Id, payload: &[u8]) -> Option<(u8, Self)> {
        let payload: [u8; BYTES] = payload.try_into().ok()?;
        let [low, high, _, _, a, b, c, d] = payload;
        let reply = match id.kind {
            kind::FEEDBACK if payload.starts_with(&VERSION) => {
                let [_, _, _, a, b, c, d, _] = payload;
                Self::Version([a, b, c, d])
            }
            kind::FEEDBACK => Self::Feedback(Feedback::of(id.data, payload)),
            kind::REPORT => Self::Report(Feedback::of(id.data, payload)),
            kind::DEVICE if id.target == ANY_HOST => Self::Device(payload),
            kind::READ => {
                let has_value = id.data >> 8 == 0;
                Self::Parameter(u16::from_le_bytes([low, high]), has_value.then_some([a, b, c, d]))
            }
            kind::FAULTS => {
                let [low, high, c0, d0, ..] = payload;
                let faults = u32::from_le_bytes([low, high, c0, d0]);
                Self::Faults { faults, warnings: u32::from_le_bytes([a, b, c, d]) }
            }
            _ => return None,
        };
        Some((id.data as u8, reply))
    }
}
