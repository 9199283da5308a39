//! The frames: commands to a motor, and its answers.

use crate::fault::Faults;
use crate::mit::ControlCodes;
use crate::state::StateCodes;

/// Number of bytes of every frame.
const BYTES: usize = 8;
/// Function of the command 0x20 that sets the id.
const FUNCTION_ID: u8 = 5;
/// 0.01° in rad.
const ANGLE: f64 = core::f64::consts::PI / 18_000.0;

/// Ids, without the id of the motor.
pub(super) mod base {
    pub(crate) const COMMAND: u16 = 0x140;
    pub(crate) const ANSWER: u16 = 0x240;
    pub(crate) const IMPEDANCE: u16 = 0x400;
    pub(crate) const STATE: u16 = 0x500;
    /// A command to all motors, and the command that reads or writes their id.
    #[cfg(feature = "drive")]
    pub(crate) const SHARED: [u16; 2] = [0x280, 0x300];
}

/// The first bytes of commands and answers.
pub(super) mod number {
    pub(crate) const FUNCTION: u8 = 0x20;
    pub(crate) const SET_ZERO: u8 = 0x64;
    pub(crate) const RESET: u8 = 0x76;
    pub(crate) const STOP: u8 = 0x80;
    pub(crate) const ANGLE: u8 = 0x92;
    pub(crate) const STATUS: u8 = 0x9A;
    pub(crate) const MOTION: u8 = 0x9C;
    pub(crate) const VERSION: u8 = 0xB2;
}

/// A command to a motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Follow an impedance. The motor needs no enable. Answered by [`Reply::State`].
    Control(ControlCodes),
    /// Take this id after the next restart (0x20, function 5).
    SetId(u8),
    /// Store the present position as zero. It acts after the next restart (0x64).
    SetZero,
    /// Restart (0x76). Not answered.
    Reset,
    /// Switch the drive off (0x80).
    Stop,
    /// Report the angle over any number of turns (0x92).
    GetAngle,
    /// Report temperature, voltage and errors (0x9A). Moves and changes nothing.
    GetStatus,
    /// Report the velocity (0x9C).
    GetMotion,
    /// Report the date of the firmware (0xB2).
    GetVersion,
}

impl Command {
    /// Returns id and payload of the command to `motor`.
    #[must_use]
    #[inline]
    pub fn encode(self, motor: u8) -> (u16, [u8; BYTES]) {
        let to = |base: u16| base + u16::from(motor);
        match self {
            Self::Control(codes) => (to(base::IMPEDANCE), codes.pack()),
            Self::SetId(id) => (to(base::COMMAND), [number::FUNCTION, FUNCTION_ID, 0, 0, id, 0, 0, 0]),
            _ => (to(base::COMMAND), [self.number(), 0, 0, 0, 0, 0, 0, 0]),
        }
    }

    /// Returns the first byte of the command and of its answer; 0 for an impedance, which has none.
    #[must_use]
    pub const fn number(self) -> u8 {
        match self {
            Self::Control(_) => 0,
            Self::SetId(_) => number::FUNCTION,
            Self::SetZero => number::SET_ZERO,
            Self::Reset => number::RESET,
            Self::Stop => number::STOP,
            Self::GetAngle => number::ANGLE,
            Self::GetStatus => number::STATUS,
            Self::GetMotion => number::MOTION,
            Self::GetVersion => number::VERSION,
        }
    }
}

/// The errors of a status.
const ERRORS: [(u64, Faults); 8] = [
    // Stalled.
    (0x0002, Faults::OVERLOAD),
    (0x0004, Faults::UNDER_VOLTAGE),
    (0x0008, Faults::OVER_VOLTAGE),
    (0x0010, Faults::OVER_CURRENT),
    // Too much power.
    (0x0040, Faults::OVERLOAD),
    // Not calibrated: the sentence of this fault includes it.
    (0x0080, Faults::ENCODER),
    (0x1000, Faults::MOTOR_OVER_TEMPERATURE),
    (0x2000, Faults::ENCODER),
];

/// The answer to [`Command::GetStatus`]. A motor may be set to send it by itself, every 100 ms while it
/// has an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MotorStatus {
    /// °C.
    pub celsius: i8,
    /// Voltage of the supply, 0.1 V.
    pub decivolts: u16,
    /// Bits.
    pub errors: u16,
}

impl MotorStatus {
    /// Returns the faults. Too much speed, 0x0100, has no name here: it is reported by its index, 8.
    #[must_use]
    pub fn faults(self) -> Faults {
        Faults::of_bits(&ERRORS, self.errors.into())
    }

    /// Returns the voltage of the supply, V.
    #[must_use]
    pub fn volts(self) -> f32 {
        f32::from(self.decivolts) / 10.0
    }
}

/// A frame that a motor sends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reply {
    /// The answer to an impedance.
    State(StateCodes),
    /// The status.
    Status(MotorStatus),
    /// The angle over any number of turns, rad.
    Angle(f32),
    /// Temperature, °C, and velocity, rad/s.
    Motion {
        /// °C.
        celsius: i8,
        /// rad/s.
        velocity: f32,
    },
    /// The date of the firmware, as the number YYYYMMDD.
    Version(u32),
    /// The confirmation of a command, by its first byte.
    Confirmed(u8),
}

impl Reply {
    /// Decodes a standard, classic frame of `motor` with this id. `None` for a frame that this motor
    /// does not send.
    #[must_use]
    #[inline]
    pub fn decode(id: u32, payload: &[u8], motor: u8) -> Option<Self> {
        let payload: [u8; BYTES] = payload.try_into().ok()?;
        let of = |base: u16| id == u32::from(base) + u32::from(motor);
        if of(base::STATE) {
            let [sender, a, b, c, d, e, _, _] = payload;
            return (sender == motor).then(|| Self::State(StateCodes::unpack([a, b, c, d, e])));
        }
        of(base::ANSWER).then(|| Self::answer(payload)).flatten()
    }

    fn answer(payload: [u8; BYTES]) -> Option<Self> {
        let [first, celsius, _, _, a, b, c, d] = payload;
        let celsius = i8::from_le_bytes([celsius]);
        match first {
            number::STATUS => Some(Self::Status(MotorStatus {
                celsius,
                decivolts: u16::from_le_bytes([a, b]),
                errors: u16::from_le_bytes([c, d]),
            })),
            number::ANGLE => Some(Self::Angle((f64::from(i32::from_le_bytes([a, b, c, d])) * ANGLE) as f32)),
            number::MOTION => {
                let degrees = i16::from_le_bytes([a, b]);
                Some(Self::Motion { celsius, velocity: f32::from(degrees).to_radians() })
            }
            number::VERSION => Some(Self::Version(u32::from_le_bytes([a, b, c, d]))),
            number::STOP | number::SET_ZERO | number::FUNCTION => Some(Self::Confirmed(first)),
            _ => None,
        }
    }

    /// Returns the first byte of the command that it answers; 0 for that of an impedance.
    #[must_use]
    #[inline]
    pub const fn number(&self) -> u8 {
        match self {
            Self::State(_) => 0,
            Self::Status(_) => number::STATUS,
            Self::Angle(_) => number::ANGLE,
            Self::Motion { .. } => number::MOTION,
            Self::Version(_) => number::VERSION,
            Self::Confirmed(number) => *number,
        }
    }
}
