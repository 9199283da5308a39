//! Host to motor. Source: MIT document 1.1.

use crate::error::{DecodeError, EncodeError, Quantity};
use crate::field::{self, TWELVE_BITS};
use crate::profile::Profile;
use crate::scale::Scales;

/// The control frame, from the most significant bit: position, velocity, kp, kd, torque. Eight
/// bytes.
const WIDTHS: [u32; 5] = [16, 12, 12, 12, 12];

const FAULT: u8 = 0xFB;
const START: u8 = 0xFC;
const STOP: u8 = 0xFD;
const SET_ZERO: u8 = 0xFE;

/// The F_CMD byte that clears a fault. Any other value requests the fault number.
const F_CMD_CLEAR: u8 = 0xFF;
const F_CMD_GET: u8 = 0x00;

/// An impedance setpoint. The motor produces kp·(position - p) + kd·(velocity - v) + torque, with
/// its own position p and velocity v.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Impedance {
    /// Position of the output shaft, rad, within the motor's scale.
    pub position: f32,
    /// Velocity of the output shaft, rad/s, within the motor's scale.
    pub velocity: f32,
    /// Stiffness, N·m/rad, 0 to 500.
    pub kp: f32,
    /// Damping, N·m·s/rad, 0 to 5.
    pub kd: f32,
    /// Torque added at the output shaft, N·m, within the motor's scale.
    pub torque: f32,
}

impl Impedance {
    /// Returns the sum of all values except the torque, which is finite exactly when they are. In
    /// double precision, single-precision values cannot overflow.
    #[inline]
    fn sum(&self) -> f64 {
        f64::from(self.position) + f64::from(self.velocity) + f64::from(self.kp) + f64::from(self.kd)
    }

    /// Returns the first value that is NaN or infinite; the torque when none of the others is.
    #[cold]
    fn first_not_finite(&self) -> Quantity {
        match self {
            Self { position, .. } if !position.is_finite() => Quantity::Position,
            Self { velocity, .. } if !velocity.is_finite() => Quantity::Velocity,
            Self { kp, .. } if !kp.is_finite() => Quantity::Kp,
            Self { kd, .. } if !kd.is_finite() => Quantity::Kd,
            _ => Quantity::Torque,
        }
    }
}

/// A command of the MIT protocol, decoded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// Read the fault number.
    GetFault,
    /// Clear the fault.
    ClearFault,
    /// Enter the running state.
    Start,
    /// Leave the running state. The motor replies with its state.
    Stop,
    /// Make the present position zero.
    SetZero,
    /// Follow this impedance setpoint.
    Control(Impedance),
}

impl Command {
    /// Returns the frame's bytes. Values beyond their range are clamped and take the nearest code.
    /// A control frame never becomes a special frame or all zeros ([`ControlCodes::pack`]).
    ///
    /// Real-time: does not allocate or block; takes constant time.
    ///
    /// # Errors
    ///
    /// When a value of the impedance is NaN or infinite.
    pub fn encode(&self, scales: &Scales) -> Result<[u8; 8], EncodeError> {
        let special = |codes: CommandCodes| Ok(codes.encode());
        match self {
            Self::Control(impedance) => ControlCodes::nearest(impedance, scales).map(ControlCodes::pack),
            Self::GetFault => special(CommandCodes::GetFault { f_cmd: F_CMD_GET }),
            Self::ClearFault => special(CommandCodes::ClearFault),
            Self::Start => special(CommandCodes::Start),
            Self::Stop => special(CommandCodes::Stop),
            Self::SetZero => special(CommandCodes::SetZero),
        }
    }
}

/// Decodes a command as a motor with these scales does. For tools, tests and logs; the host only
/// sends commands.
///
/// # Errors
///
/// When there are not exactly 8 bytes. Any 8 bytes are a valid command.
pub fn decode_command(bytes: &[u8], scales: &Scales) -> Result<Command, DecodeError> {
    Ok(match CommandCodes::decode(bytes)? {
        CommandCodes::GetFault { .. } => Command::GetFault,
        CommandCodes::ClearFault => Command::ClearFault,
        CommandCodes::Start => Command::Start,
        CommandCodes::Stop => Command::Stop,
        CommandCodes::SetZero => Command::SetZero,
        CommandCodes::Control(codes) => Command::Control(codes.scaled(scales)),
    })
}

impl Profile {
    /// Returns the frame of a command to a motor of this vendor, as [`Command::encode`] does. A motor
    /// that has no frame for the command is sent its stop frame.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    ///
    /// # Errors
    ///
    /// When a value of the impedance is NaN or infinite.
    pub fn encode(&self, command: &Command, scales: &Scales) -> Result<[u8; 8], EncodeError> {
        let special = &self.special;
        match command {
            Command::Start => Ok(special.start),
            Command::Stop => Ok(special.stop),
            Command::SetZero => Ok(special.zero),
            Command::ClearFault => Ok(special.clear.unwrap_or(special.stop)),
            Command::GetFault if !self.is_asked_for_faults() => Ok(special.stop),
            Command::GetFault | Command::Control(_) => command.encode(scales),
        }
    }

    /// Returns the frame of a command, as [`CommandCodes::encode`] does, for a motor of this vendor.
    #[must_use]
    pub fn encode_codes(&self, codes: CommandCodes) -> [u8; 8] {
        let special = &self.special;
        match codes {
            CommandCodes::Start => special.start,
            CommandCodes::Stop => special.stop,
            CommandCodes::SetZero => special.zero,
            CommandCodes::ClearFault => special.clear.unwrap_or(special.stop),
            CommandCodes::GetFault { .. } | CommandCodes::Control(_) => codes.encode(),
        }
    }

    /// Decodes a command as a motor of this vendor does, without scales. A fault request is always
    /// read as one.
    ///
    /// # Errors
    ///
    /// When there are not exactly 8 bytes.
    pub fn decode_codes(&self, bytes: &[u8]) -> Result<CommandCodes, DecodeError> {
        let common = CommandCodes::decode(bytes)?;
        let special = &self.special;
        let own = [
            (Some(special.start), CommandCodes::Start),
            (Some(special.stop), CommandCodes::Stop),
            (Some(special.zero), CommandCodes::SetZero),
            (special.clear, CommandCodes::ClearFault),
        ];
        let known = own.into_iter().find(|(frame, _)| frame.is_some_and(|frame| frame == bytes));
        Ok(match (known, common, <[u8; 8]>::try_from(bytes)) {
            (Some((_, codes)), ..) => codes,
            (None, CommandCodes::GetFault { .. } | CommandCodes::Control(_), _) | (None, _, Err(_)) => common,
            (None, _, Ok(bytes)) => CommandCodes::Control(ControlCodes::unpack(bytes)),
        })
    }
}

/// A command as codes, without scales.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommandCodes {
    /// Six 0xFF, then `f_cmd`, then 0xFB.
    GetFault {
        /// Any byte except 0xFF, which would clear the fault.
        f_cmd: u8,
    },
    /// Seven 0xFF, then 0xFB.
    ClearFault,
    /// Seven 0xFF, then 0xFC.
    Start,
    /// Seven 0xFF, then 0xFD.
    Stop,
    /// Seven 0xFF, then 0xFE.
    SetZero,
    /// Everything else.
    Control(ControlCodes),
}

impl CommandCodes {
    /// Returns the frame's bytes.
    #[must_use]
    pub fn encode(self) -> [u8; 8] {
        let special = |f_cmd, last| [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, f_cmd, last];
        match self {
            Self::GetFault { f_cmd } => special(if f_cmd == F_CMD_CLEAR { F_CMD_GET } else { f_cmd }, FAULT),
            Self::ClearFault => special(F_CMD_CLEAR, FAULT),
            Self::Start => special(0xFF, START),
            Self::Stop => special(0xFF, STOP),
            Self::SetZero => special(0xFF, SET_ZERO),
            Self::Control(codes) => codes.pack(),
        }
    }

    /// Decodes a command as a motor does, without scales.
    ///
    /// # Errors
    ///
    /// When there are not exactly 8 bytes.
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        let bytes = <[u8; 8]>::try_from(bytes).map_err(|_| DecodeError::Length {
            least: 8,
            most: 8,
            received: bytes.len(),
        })?;
        Ok(match bytes {
            [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, F_CMD_CLEAR, FAULT] => Self::ClearFault,
            [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, f_cmd, FAULT] => Self::GetFault { f_cmd },
            [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, START] => Self::Start,
            [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, STOP] => Self::Stop,
            [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, SET_ZERO] => Self::SetZero,
            _ => Self::Control(ControlCodes::unpack(bytes)),
        })
    }
}

/// The five codes of a control frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct ControlCodes {
    /// 16 bits, see [`Scales::position`].
    pub position: u16,
    /// 12 bits, see [`Scales::velocity`].
    pub velocity: u16,
    /// 12 bits, see [`Scales::kp`].
    pub kp: u16,
    /// 12 bits, see [`Scales::kd`].
    pub kd: u16,
    /// 12 bits, see [`Scales::torque`].
    pub torque: u16,
}

impl ControlCodes {
    /// Returns the nearest codes, after clamping.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    ///
    /// # Errors
    ///
    /// When a value is NaN or infinite.
    #[inline]
    pub fn nearest(impedance: &Impedance, scales: &Scales) -> Result<Self, EncodeError> {
        // The masks change nothing, because a field of 12 bits has no wider code. They let the
        // compiler remove the saturation from `pack`.
        Self::nearest_with(impedance, scales, |&Impedance { velocity, torque, .. }| {
            [
                scales.velocity.encode_finite(velocity.into()) & TWELVE_BITS,
                scales.torque.encode_finite(torque.into()) & TWELVE_BITS,
            ]
        })
    }

    /// Returns the nearest codes, after clamping, with the codes of velocity and torque that
    /// `quantise` returns. It is called with finite values only.
    ///
    /// Real-time: does not allocate or block; takes constant time, where `quantise` does.
    ///
    /// # Errors
    ///
    /// When a value is NaN or infinite.
    #[inline(always)]
    pub fn nearest_with(
        impedance: &Impedance,
        scales: &Scales,
        quantise: impl FnOnce(&Impedance) -> [u16; 2],
    ) -> Result<Self, EncodeError> {
        let Impedance { position, kp, kd, torque, .. } = *impedance;
        if !(impedance.sum() + f64::from(torque)).is_finite() {
            return Err(EncodeError::NotFinite { field: impedance.first_not_finite() });
        }
        let [velocity, torque] = quantise(impedance);
        Ok(Self {
            position: scales.position.encode_finite(position.into()),
            velocity,
            kp: scales.kp.encode_finite(kp.into()) & TWELVE_BITS,
            kd: scales.kd.encode_finite(kd.into()) & TWELVE_BITS,
            torque,
        })
    }

    /// Returns the setpoint that a motor with these scales reads from the codes.
    #[must_use]
    pub fn scaled(&self, scales: &Scales) -> Impedance {
        Impedance {
            position: scales.position.decode(self.position) as f32,
            velocity: scales.velocity.decode(self.velocity) as f32,
            kp: scales.kp.decode(self.kp) as f32,
            kd: scales.kd.decode(self.kd) as f32,
            torque: scales.torque.decode(self.torque) as f32,
        }
    }

    /// Returns the frame's bytes, changed by one code where they would not be a control frame:
    /// - Six leading 0xFF begin every special frame: kp is lowered by one code (0.12 N·m/rad).
    /// - All zeros usually come from an empty buffer: position is raised by one code (0.4 mrad).
    ///
    /// A code wider than its field saturates.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    #[must_use]
    #[inline]
    pub fn pack(mut self) -> [u8; 8] {
        let mut word = self.word();
        if word >> 16 == 0xFFFF_FFFF_FFFF {
            self.kp = 0xFFE;
            word = self.word();
        } else if word == 0 {
            self.position = 1;
            word = self.word();
        }
        word.to_be_bytes()
    }

    /// Returns the frame as a number, without these changes.
    #[inline]
    fn word(self) -> u64 {
        field::pack(WIDTHS, [self.position, self.velocity, self.kp, self.kd, self.torque])
    }

    /// Returns the codes in a frame, without a check for special frames.
    #[must_use]
    pub fn unpack(bytes: [u8; 8]) -> Self {
        let [position, velocity, kp, kd, torque] = field::unpack(WIDTHS, u64::from_be_bytes(bytes));
        Self { position, velocity, kp, kd, torque }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The special frames of the MIT document 1.1: 256 with 0xFB, and one each with 0xFC, 0xFD and
    /// 0xFE.
    fn special_frames() -> impl Iterator<Item = [u8; 8]> {
        let with = |f_cmd, last| [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, f_cmd, last];
        let faults = (0..=0xFF).map(move |f_cmd| with(f_cmd, 0xFB));
        faults.chain([0xFC, 0xFD, 0xFE].map(|last| with(0xFF, last)))
    }

    #[test]
    fn special_frames_never_result_from_spelling_codes() {
        assert_eq!(special_frames().count(), 259);
        for bytes in special_frames() {
            let codes = ControlCodes::unpack(bytes);
            assert_ne!(codes.pack(), bytes);
            let guarded = ControlCodes { kp: codes.kp - 1, ..codes };
            assert_eq!(CommandCodes::decode(&codes.pack()), Ok(CommandCodes::Control(guarded)));
        }
    }

    #[test]
    fn six_leading_ff_are_never_packed() {
        for tail in 0..=u16::MAX {
            let [a, b] = tail.to_be_bytes();
            let codes = ControlCodes::unpack([0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, a, b]);
            assert_eq!(codes.pack(), [0xFF, 0xFF, 0xFF, 0xFF, 0xFE, 0xFF, a, b]);
        }
    }

    #[test]
    fn all_zero_codes_become_one_code_of_position() {
        assert_eq!(ControlCodes::default().pack(), [0, 1, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn saturating_codes_are_guarded_like_full_ones() {
        let wide =
            ControlCodes { position: 0xFFFF, velocity: 0xFFFF, kp: 0xFFFF, kd: 0xFFFF, torque: 0xFFFF };
        assert_eq!(wide.pack(), [0xFF, 0xFF, 0xFF, 0xFF, 0xFE, 0xFF, 0xFF, 0xFF]);
    }

    #[test]
    fn special_frames_are_read_and_written_back() {
        for bytes in special_frames() {
            let command = CommandCodes::decode(&bytes).unwrap();
            assert!(!matches!(command, CommandCodes::Control(_)), "{bytes:02X?}");
            assert_eq!(command.encode(), bytes);
        }
        assert_eq!(CommandCodes::GetFault { f_cmd: 0xFF }.encode()[6], 0, "asking never clears");
    }

    #[test]
    fn every_truncated_and_oversized_command_is_refused() {
        for received in (0..8).chain(9..=64) {
            let refused = DecodeError::Length { least: 8, most: 8, received };
            assert_eq!(CommandCodes::decode(&[0xFF; 64][..received]), Err(refused));
        }
    }

    #[test]
    fn each_value_that_is_not_finite_is_named() {
        let scales = Scales::by_current(0.1, 8.0).unwrap();
        let zero = Impedance::default();
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for (impedance, field) in [
                (Impedance { position: value, ..zero }, Quantity::Position),
                (Impedance { velocity: value, ..zero }, Quantity::Velocity),
                (Impedance { kp: value, ..zero }, Quantity::Kp),
                (Impedance { kd: value, ..zero }, Quantity::Kd),
                (Impedance { torque: value, ..zero }, Quantity::Torque),
            ] {
                let refused = Err(EncodeError::NotFinite { field });
                assert_eq!(Command::Control(impedance).encode(&scales), refused);
            }
        }
    }
}
