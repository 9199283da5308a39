//! Host to motor. Source: GIM document Table 4 and sections 3.2.1 to 3.2.19.

use crate::error::DecodeError;
use crate::execution_time::ExecutionTime;
use crate::gim::configuration::ConfigurationKey;
use crate::gim::value::{Finite, Value};
use crate::mit::ControlCodes;

/// The first byte of a frame. Source: GIM document Table 4, and 3.2.18 for calibration, which the
/// table lacks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
#[expect(missing_docs, reason = "each is documented at the command it begins")]
pub enum CommandCode {
    ResetConfiguration = 0x81,
    RefreshConfiguration = 0x82,
    ModifyConfiguration = 0x83,
    RetrieveConfiguration = 0x84,
    StartMotor = 0x91,
    StopMotor = 0x92,
    TorqueControl = 0x93,
    SpeedControl = 0x94,
    PositionControl = 0x95,
    PtsControl = 0x96,
    StopControl = 0x97,
    ModifyParameter = 0xA1,
    RetrieveParameter = 0xA2,
    GetVersion = 0xB1,
    GetFault = 0xB2,
    AcknowledgeFault = 0xB3,
    RetrieveIndicator = 0xB4,
    Calibration = 0xB5,
    UpdateFirmware = 0xC1,
}

impl CommandCode {
    /// All command codes, in ascending order.
    pub const ALL: [Self; 19] = [
        Self::ResetConfiguration,
        Self::RefreshConfiguration,
        Self::ModifyConfiguration,
        Self::RetrieveConfiguration,
        Self::StartMotor,
        Self::StopMotor,
        Self::TorqueControl,
        Self::SpeedControl,
        Self::PositionControl,
        Self::PtsControl,
        Self::StopControl,
        Self::ModifyParameter,
        Self::RetrieveParameter,
        Self::GetVersion,
        Self::GetFault,
        Self::AcknowledgeFault,
        Self::RetrieveIndicator,
        Self::Calibration,
        Self::UpdateFirmware,
    ];

    /// Returns the command's name in Table 4, in lower case.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::ResetConfiguration => "reset configuration",
            Self::RefreshConfiguration => "refresh configuration",
            Self::ModifyConfiguration => "modify configuration",
            Self::RetrieveConfiguration => "retrieve configuration",
            Self::StartMotor => "start motor",
            Self::StopMotor => "stop motor",
            Self::TorqueControl => "torque control",
            Self::SpeedControl => "speed control",
            Self::PositionControl => "position control",
            Self::PtsControl => "PTS control",
            Self::StopControl => "stop control",
            Self::ModifyParameter => "modify parameter",
            Self::RetrieveParameter => "retrieve parameter",
            Self::GetVersion => "get version",
            Self::GetFault => "get fault",
            Self::AcknowledgeFault => "acknowledge fault",
            Self::RetrieveIndicator => "retrieve indicator",
            Self::Calibration => "calibration",
            Self::UpdateFirmware => "update firmware",
        }
    }

    /// Returns the code with this value.
    ///
    /// # Errors
    ///
    /// When no command begins with it.
    pub fn from_byte(byte: u8) -> Result<Self, DecodeError> {
        let known = Self::ALL.into_iter().find(|&code| code as u8 == byte);
        known.ok_or(DecodeError::UnknownCommand { received: byte })
    }
}

/// A type of calibration. The shaft turns while it runs. Source: GIM document Table 11.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Calibration(
    /// The CaliType byte, as received. The table lists only two values.
    pub u8,
);

impl Calibration {
    /// The order of the phases.
    pub const PHASE_ORDER: Self = Self(0x00);
    /// The encoder.
    pub const ENCODER: Self = Self(0x01);
}

/// A command of the native protocol.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// Reset every configuration item to its default (3.2.1).
    ResetConfiguration,
    /// Apply all modified configuration items (3.2.2).
    RefreshConfiguration,
    /// Write a configuration item (3.2.3).
    ModifyConfiguration {
        /// The item among those of the value's type.
        conf_id: u8,
        /// Its new value.
        value: Value,
    },
    /// Read a configuration item (3.2.4).
    RetrieveConfiguration(ConfigurationKey),
    /// Enter the running state (3.2.5).
    StartMotor,
    /// Leave the running state (3.2.6).
    StopMotor,
    /// Hold a torque (3.2.7).
    TorqueControl {
        /// Torque at the output shaft, N·m.
        torque: Finite,
        /// Execution time.
        duration: ExecutionTime,
    },
    /// Hold a speed (3.2.8).
    SpeedControl {
        /// Speed of the output shaft, rpm.
        speed_rpm: Finite,
        /// Execution time.
        duration: ExecutionTime,
    },
    /// Go to a position (3.2.9).
    PositionControl {
        /// Position of the output shaft over any number of turns, rad.
        position: Finite,
        /// Execution time.
        duration: ExecutionTime,
    },
    /// Listed, but not supported by any driver (3.2.10). Only for tools that display it.
    PtsControl,
    /// Abort the control command that is being executed (3.2.11).
    StopControl,
    /// Write a parameter (3.2.12).
    ModifyParameter {
        /// The ParaID byte, see [`PARAMETERS`](crate::gim::PARAMETERS).
        para_id: u8,
        /// Its new value.
        value: u32,
    },
    /// Read a parameter (3.2.13).
    RetrieveParameter {
        /// The ParaID byte, see [`PARAMETERS`](crate::gim::PARAMETERS).
        para_id: u8,
    },
    /// Read the firmware's version (3.2.14).
    GetVersion,
    /// Read the fault number (3.2.15).
    GetFault,
    /// Clear the fault (3.2.16).
    AcknowledgeFault,
    /// Read a measurement (3.2.17).
    RetrieveIndicator {
        /// The IndID byte, see [`INDICATORS`](crate::gim::INDICATORS).
        ind_id: u8,
    },
    /// Calibrate: the shaft turns (3.2.18).
    Calibration(Calibration),
    /// Leave the bus and wait for new firmware. The motor sends no reply (3.2.19).
    UpdateFirmware,
}

impl Command {
    /// Returns the first byte of the frame.
    #[must_use]
    pub const fn code(&self) -> CommandCode {
        match self {
            Self::ResetConfiguration => CommandCode::ResetConfiguration,
            Self::RefreshConfiguration => CommandCode::RefreshConfiguration,
            Self::ModifyConfiguration { .. } => CommandCode::ModifyConfiguration,
            Self::RetrieveConfiguration(_) => CommandCode::RetrieveConfiguration,
            Self::StartMotor => CommandCode::StartMotor,
            Self::StopMotor => CommandCode::StopMotor,
            Self::TorqueControl { .. } => CommandCode::TorqueControl,
            Self::SpeedControl { .. } => CommandCode::SpeedControl,
            Self::PositionControl { .. } => CommandCode::PositionControl,
            Self::PtsControl => CommandCode::PtsControl,
            Self::StopControl => CommandCode::StopControl,
            Self::ModifyParameter { .. } => CommandCode::ModifyParameter,
            Self::RetrieveParameter { .. } => CommandCode::RetrieveParameter,
            Self::GetVersion => CommandCode::GetVersion,
            Self::GetFault => CommandCode::GetFault,
            Self::AcknowledgeFault => CommandCode::AcknowledgeFault,
            Self::RetrieveIndicator { .. } => CommandCode::RetrieveIndicator,
            Self::Calibration(_) => CommandCode::Calibration,
            Self::UpdateFirmware => CommandCode::UpdateFirmware,
        }
    }

    /// Returns the frame's bytes, with zeros in the free bytes. Only for a motor known to be in
    /// native mode: see [`encode_mit_safe`](Self::encode_mit_safe).
    ///
    /// Real-time: does not allocate or block; takes constant time.
    #[must_use]
    pub fn encode(&self) -> [u8; 8] {
        self.encode_over([0; 8])
    }

    /// Returns the frame's bytes. A motor in MIT mode reads them as a control frame without
    /// stiffness, damping and torque. `None` when the command's own values leave too few free bytes
    /// for that.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    #[must_use]
    pub fn encode_mit_safe(&self) -> Option<[u8; 8]> {
        let bytes = self.encode_over(MIT_NEUTRAL);
        let ControlCodes { kp, kd, torque, .. } = ControlCodes::unpack(bytes);
        let neutral = ControlCodes::unpack(MIT_NEUTRAL);
        ([kp, kd, torque] == [neutral.kp, neutral.kd, neutral.torque]).then_some(bytes)
    }

    /// Returns the frame's bytes, with the bytes of `filler` where the command leaves them free.
    #[must_use]
    pub fn encode_over(&self, filler: [u8; 8]) -> [u8; 8] {
        let [_, b, c, d, e, f, g, h] = filler;
        let code = self.code() as u8;
        let held = |[p, q, r, s]: [u8; 4], [t, u, v]: [u8; 3]| [code, p, q, r, s, t, u, v];
        match *self {
            Self::ModifyConfiguration { conf_id, value } => {
                let [p, q, r, s] = value.to_bytes();
                [code, value.value_type() as u8, conf_id, d, p, q, r, s]
            }
            Self::RetrieveConfiguration(ConfigurationKey { conf_type, conf_id }) => {
                [code, conf_type, conf_id, d, e, f, g, h]
            }
            Self::TorqueControl { torque: target, duration }
            | Self::SpeedControl { speed_rpm: target, duration }
            | Self::PositionControl { position: target, duration } => {
                held(target.to_bytes(), duration.to_bytes())
            }
            Self::ModifyParameter { para_id, value } => {
                let [p, q, r, s] = value.to_le_bytes();
                [code, para_id, c, d, p, q, r, s]
            }
            Self::RetrieveParameter { para_id: selector }
            | Self::RetrieveIndicator { ind_id: selector }
            | Self::Calibration(Calibration(selector)) => [code, selector, c, d, e, f, g, h],
            _ => [code, b, c, d, e, f, g, h],
        }
    }
}

/// Values of the free bytes for which a motor in MIT mode reads kp 0, kd 0 and the middle torque
/// code.
const MIT_NEUTRAL: [u8; 8] = [0x00, 0x00, 0x80, 0x00, 0x00, 0x00, 0x08, 0x00];

/// Decodes a command as a motor in native mode does. For tools, tests and logs; the host only sends
/// commands.
///
/// # Errors
///
/// When there are not exactly 8 bytes, the command or a configuration type is unknown, or a float
/// is not finite.
pub fn decode_command(bytes: &[u8]) -> Result<Command, DecodeError> {
    let [code, rest @ ..] = eight(bytes)?;
    let [b, c, _, p, q, r, s] = rest;
    let data = [p, q, r, s];
    let target = || Finite::from_bytes([rest[0], rest[1], rest[2], rest[3]]);
    let duration = ExecutionTime::from_bytes([rest[4], rest[5], rest[6]]);
    Ok(match CommandCode::from_byte(code)? {
        CommandCode::ResetConfiguration => Command::ResetConfiguration,
        CommandCode::RefreshConfiguration => Command::RefreshConfiguration,
        CommandCode::ModifyConfiguration => {
            Command::ModifyConfiguration { conf_id: c, value: Value::from_bytes(b, data)? }
        }
        CommandCode::RetrieveConfiguration => {
            Command::RetrieveConfiguration(ConfigurationKey { conf_type: b, conf_id: c })
        }
        CommandCode::StartMotor => Command::StartMotor,
        CommandCode::StopMotor => Command::StopMotor,
        CommandCode::TorqueControl => Command::TorqueControl { torque: target()?, duration },
        CommandCode::SpeedControl => Command::SpeedControl { speed_rpm: target()?, duration },
        CommandCode::PositionControl => Command::PositionControl { position: target()?, duration },
        CommandCode::PtsControl => Command::PtsControl,
        CommandCode::StopControl => Command::StopControl,
        CommandCode::ModifyParameter => {
            Command::ModifyParameter { para_id: b, value: u32::from_le_bytes(data) }
        }
        CommandCode::RetrieveParameter => Command::RetrieveParameter { para_id: b },
        CommandCode::GetVersion => Command::GetVersion,
        CommandCode::GetFault => Command::GetFault,
        CommandCode::AcknowledgeFault => Command::AcknowledgeFault,
        CommandCode::RetrieveIndicator => Command::RetrieveIndicator { ind_id: b },
        CommandCode::Calibration => Command::Calibration(Calibration(b)),
        CommandCode::UpdateFirmware => Command::UpdateFirmware,
    })
}

/// Every native frame has eight bytes, both ways (GIM document, Table 2).
pub(super) fn eight(bytes: &[u8]) -> Result<[u8; 8], DecodeError> {
    let received = bytes.len();
    <[u8; 8]>::try_from(bytes).map_err(|_| DecodeError::Length { least: 8, most: 8, received })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scales;
    use crate::gim::Value;
    use crate::mit;

    const ZERO: Finite = Finite::new(0.0).unwrap();
    const SECOND: ExecutionTime = ExecutionTime::from_millis(1000).unwrap();

    #[test]
    fn every_truncated_and_oversized_command_is_refused() {
        for received in (0..8).chain(9..=64) {
            let refused = DecodeError::Length { least: 8, most: 8, received };
            assert_eq!(decode_command(&[0x91; 64][..received]), Err(refused));
        }
    }

    #[test]
    fn every_first_byte_is_one_command_or_refused() {
        let known = |byte: u8| CommandCode::ALL.iter().any(|&code| code as u8 == byte);
        for byte in 0..=u8::MAX {
            match decode_command(&[byte, 0, 0, 0, 0, 0, 0, 0]) {
                Ok(command) => assert_eq!(command.code() as u8, byte),
                Err(error) => assert_eq!(error, DecodeError::UnknownCommand { received: byte }),
            }
            assert_eq!(CommandCode::from_byte(byte).is_ok(), known(byte));
        }
    }

    #[test]
    fn padded_command_means_no_torque_in_mit_mode() {
        let scales = Scales::by_current(0.1, 8.0).unwrap();
        for code in CommandCode::ALL {
            let command = decode_command(&[code as u8, 1, 3, 0, 0, 0, 0, 0]).unwrap();
            let Some(bytes) = command.encode_mit_safe() else { continue };
            assert_eq!(decode_command(&bytes), Ok(command));
            let Ok(mit::Command::Control(control)) = mit::decode_command(&bytes, &scales) else {
                panic!("{code:?} is a special frame")
            };
            assert_eq!((control.kp, control.kd), (0.0, 0.0), "{code:?}");
            assert!(f64::from(control.torque.abs()) < scales.torque.step(), "{code:?}");
        }
    }

    #[test]
    fn commands_with_values_have_no_safe_padding() {
        let value = Value::Integer(1);
        for command in [
            Command::ModifyConfiguration { conf_id: 0x1C, value },
            Command::TorqueControl { torque: ZERO, duration: SECOND },
            Command::SpeedControl { speed_rpm: ZERO, duration: SECOND },
            Command::PositionControl { position: ZERO, duration: SECOND },
            Command::ModifyParameter { para_id: 0, value: 1 },
        ] {
            assert_eq!(command.encode_mit_safe(), None, "{command:?}");
        }
    }

    #[test]
    fn nonfinite_float_is_refused_everywhere() {
        let nan = [0x00, 0x00, 0xC0, 0x7F];
        let refused = Err(DecodeError::NotFinite { received: 0x7FC0_0000 });
        for code in [0x93, 0x94, 0x95] {
            assert_eq!(decode_command(&[code, nan[0], nan[1], nan[2], nan[3], 0, 0, 0]), refused);
        }
        assert_eq!(decode_command(&[0x83, 0x01, 0x03, 0, nan[0], nan[1], nan[2], nan[3]]), refused);
        assert_eq!(Finite::new(f32::INFINITY), None);
    }
}
