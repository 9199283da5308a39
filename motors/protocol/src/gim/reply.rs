//! Motor to host. Source: GIM document 3.2.1 to 3.2.18.
//!
//! The result byte has index 1. It has index 2 where the reply repeats one number of the request,
//! and 3 where it repeats two.

use crate::error::DecodeError;
use crate::fault::FaultBits;
use crate::gim::command::{Calibration, Command, CommandCode, eight};
use crate::gim::configuration::ConfigurationKey;
use crate::gim::result::{Outcome, Refusal};
use crate::gim::value::{Finite, Value};
use crate::scale::Scales;
use crate::state::StateCodes;

/// Kind of the open request. The reply to a calibration is printed with the command byte of an
/// indicator (3.2.18).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Pending {
    /// A calibration: 0xB4 is its reply.
    Calibration,
    /// Any other request, or none: 0xB4 is an indicator.
    Other,
}

/// A motor's reply.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reply {
    /// Reply to a command that returns only a result.
    Done {
        /// The command.
        command: CommandCode,
        /// The result.
        outcome: Outcome<()>,
    },
    /// Reply to torque, speed and position control.
    State {
        /// The command.
        command: CommandCode,
        /// The motion.
        outcome: Outcome<State>,
    },
    /// Reply to modify configuration.
    ConfigurationModified {
        /// The item.
        key: ConfigurationKey,
        /// The result.
        outcome: Outcome<()>,
    },
    /// Reply to retrieve configuration.
    Configuration {
        /// The item.
        key: ConfigurationKey,
        /// Its value.
        outcome: Outcome<Value>,
    },
    /// Reply to modify parameter.
    ParameterModified {
        /// The ParaID byte.
        para_id: u8,
        /// The result.
        outcome: Outcome<()>,
    },
    /// Reply to retrieve parameter.
    Parameter {
        /// The ParaID byte.
        para_id: u8,
        /// Its value.
        outcome: Outcome<u32>,
    },
    /// Reply to get version.
    Version(Outcome<u32>),
    /// Reply to get fault.
    Fault(Outcome<FaultBits>),
    /// Reply to retrieve indicator.
    Indicator {
        /// The IndID byte.
        ind_id: u8,
        /// Its value, in the unit of Table 10.
        outcome: Outcome<Finite>,
    },
    /// Reply to calibration.
    Calibrated {
        /// The type of the calibration.
        calibration: Calibration,
        /// The result.
        outcome: Outcome<()>,
        /// The command byte of the reply: that of calibration, or that of an indicator as printed.
        echo: CommandCode,
    },
    /// Reply to a command that is not in Table 4. The result is read from its most common index.
    Unknown {
        /// The first byte.
        command: u8,
        /// The result.
        outcome: Outcome<()>,
    },
}

/// The motion that a motor reports.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// The higher of the temperatures of motor and driver board, °C.
    pub temperature_celsius: i8,
    /// Position of the output shaft, rad, -12.5 to 12.5.
    pub position: f32,
    /// Velocity of the output shaft, rad/s, -65 to 65.
    pub velocity: f32,
    /// Torque at the output shaft, N·m, computed by the scale from the motor's q-axis current.
    pub torque: f32,
    /// The codes of position, velocity and torque, as received.
    pub codes: StateCodes,
}

impl State {
    /// Returns the state that these codes stand for.
    #[must_use]
    pub fn new(temperature_celsius: i8, codes: StateCodes, scales: &Scales) -> Self {
        let [position, velocity, torque] = codes.scaled(scales);
        Self { temperature_celsius, position, velocity, torque, codes }
    }

    /// Position is little endian here; velocity and torque are packed as in an MIT reply (3.2.7).
    fn from_bytes([temperature, low, high, st @ ..]: [u8; 6], scales: &Scales) -> Self {
        let codes = StateCodes::unpack([high, low, st[0], st[1], st[2]]);
        Self::new(i8::from_le_bytes([temperature]), codes, scales)
    }

    fn to_bytes(self) -> [u8; 6] {
        let [high, low, a, b, c] = self.codes.pack();
        let [temperature] = self.temperature_celsius.to_le_bytes();
        [temperature, low, high, a, b, c]
    }
}

/// Decodes a reply. `pending` determines the meaning of the command byte 0xB4, which begins two
/// kinds of reply.
///
/// Real-time: does not allocate or block; takes constant time.
///
/// # Errors
///
/// When there are not exactly 8 bytes, a configuration type is unknown, or a float is not finite.
pub fn decode_reply(payload: &[u8], pending: Pending, scales: &Scales) -> Result<Reply, DecodeError> {
    use CommandCode as Code;
    let [code, rest @ ..] = eight(payload)?;
    let [b, c, d, p, q, r, s] = rest;
    let data = [p, q, r, s];
    let Ok(command) = Code::from_byte(code) else {
        return Ok(Reply::Unknown { command: code, outcome: Refusal::check(b) });
    };
    let key = ConfigurationKey { conf_type: b, conf_id: c };
    let calibrated =
        Reply::Calibrated { calibration: Calibration(b), outcome: Refusal::check(c), echo: command };
    Ok(match command {
        Code::TorqueControl | Code::SpeedControl | Code::PositionControl => {
            let state = || State::from_bytes([c, d, p, q, r, s], scales);
            Reply::State { command, outcome: Refusal::check(b).map(|()| state()) }
        }
        Code::ModifyConfiguration => Reply::ConfigurationModified { key, outcome: Refusal::check(d) },
        Code::RetrieveConfiguration => {
            Reply::Configuration { key, outcome: checked(d, || Value::from_bytes(b, data))? }
        }
        Code::ModifyParameter => Reply::ParameterModified { para_id: b, outcome: Refusal::check(c) },
        Code::RetrieveParameter => {
            let value = u32::from_le_bytes(data);
            Reply::Parameter { para_id: b, outcome: Refusal::check(c).map(|()| value) }
        }
        Code::GetVersion => Reply::Version(Refusal::check(b).map(|()| u32::from_le_bytes(data))),
        Code::GetFault => Reply::Fault(Refusal::check(b).map(|()| FaultBits(c))),
        Code::RetrieveIndicator if pending == Pending::Calibration => calibrated,
        Code::RetrieveIndicator => {
            Reply::Indicator { ind_id: b, outcome: checked(c, || Finite::from_bytes(data))? }
        }
        Code::Calibration => calibrated,
        _ => Reply::Done { command, outcome: Refusal::check(b) },
    })
}

/// Reads the value only of a reply that reports success. In other replies these bytes have no
/// meaning.
fn checked<T>(res: u8, value: impl FnOnce() -> Result<T, DecodeError>) -> Result<Outcome<T>, DecodeError> {
    match Refusal::check(res) {
        Ok(()) => value().map(Ok),
        Err(refusal) => Ok(Err(refusal)),
    }
}

/// The RES byte.
fn res<T>(outcome: Outcome<T>) -> u8 {
    outcome.err().map_or(0, Refusal::code)
}

/// Returns `true` when the payload `reply` can answer the payload `request`. Compares the bytes
/// that a reply repeats: the command, and the numbers of 3.2.3, 3.2.4, 3.2.12, 3.2.13, 3.2.17 and
/// 3.2.18. For a serial line, where no other property distinguishes a reply from noise.
/// [`Reply::answers`] compares decoded values.
///
/// Real-time: does not allocate or block; takes constant time.
#[must_use]
pub fn repeats(request: &[u8], reply: &[u8]) -> bool {
    use CommandCode as Code;
    let (Ok([asked, numbers @ ..]), Ok([code, repeated @ ..])) = (eight(request), eight(reply)) else {
        return false;
    };
    let count = match Code::from_byte(asked) {
        Ok(Code::ModifyConfiguration | Code::RetrieveConfiguration) => 2,
        Ok(Code::ModifyParameter | Code::RetrieveParameter | Code::RetrieveIndicator | Code::Calibration) => {
            1
        }
        Ok(_) | Err(_) => 0,
    };
    let is_calibration = asked == Code::Calibration as u8 && code == Code::RetrieveIndicator as u8;
    (asked == code || is_calibration) && numbers[..count] == repeated[..count]
}

impl Reply {
    /// Returns `true` when the reply can answer `command`: it repeats the command byte and the
    /// numbers.
    #[must_use]
    pub fn answers(&self, command: &Command) -> bool {
        match (*self, *command) {
            (Self::ConfigurationModified { key, .. }, Command::ModifyConfiguration { conf_id, value }) => {
                key == ConfigurationKey::new(value.value_type(), conf_id)
            }
            (Self::Configuration { key, .. }, Command::RetrieveConfiguration(asked)) => key == asked,
            (Self::ParameterModified { para_id, .. }, Command::ModifyParameter { para_id: asked, .. })
            | (Self::Parameter { para_id, .. }, Command::RetrieveParameter { para_id: asked }) => {
                para_id == asked
            }
            (Self::Indicator { ind_id, .. }, Command::RetrieveIndicator { ind_id: asked }) => ind_id == asked,
            (Self::Calibrated { calibration, .. }, Command::Calibration(asked)) => calibration == asked,
            (Self::Calibrated { .. }, _) => false,
            _ => self.code() == command.code() as u8,
        }
    }

    /// Returns the first byte of the frame.
    #[must_use]
    pub const fn code(&self) -> u8 {
        let command = match self {
            Self::Done { command, .. } | Self::State { command, .. } => *command,
            Self::ConfigurationModified { .. } => CommandCode::ModifyConfiguration,
            Self::Configuration { .. } => CommandCode::RetrieveConfiguration,
            Self::ParameterModified { .. } => CommandCode::ModifyParameter,
            Self::Parameter { .. } => CommandCode::RetrieveParameter,
            Self::Version(_) => CommandCode::GetVersion,
            Self::Fault(_) => CommandCode::GetFault,
            Self::Indicator { .. } => CommandCode::RetrieveIndicator,
            Self::Calibrated { echo, .. } => *echo,
            Self::Unknown { command, .. } => return *command,
        };
        command as u8
    }

    /// Returns the result byte of the reply, 0 for success.
    #[must_use]
    pub fn res(&self) -> u8 {
        match *self {
            Self::Done { outcome, .. }
            | Self::ConfigurationModified { outcome, .. }
            | Self::ParameterModified { outcome, .. }
            | Self::Calibrated { outcome, .. }
            | Self::Unknown { outcome, .. } => res(outcome),
            Self::State { outcome, .. } => res(outcome),
            Self::Configuration { outcome, .. } => res(outcome),
            Self::Parameter { outcome, .. } => res(outcome),
            Self::Version(outcome) => res(outcome),
            Self::Fault(outcome) => res(outcome),
            Self::Indicator { outcome, .. } => res(outcome),
        }
    }

    /// Returns the reply's bytes, with the bytes of `filler` where they have no meaning. For tools
    /// and tests; the host only receives replies.
    #[must_use]
    pub fn encode_over(&self, filler: [u8; 8]) -> [u8; 8] {
        let [_, _, c, d, e, f, g, h] = filler;
        let (code, res) = (self.code(), self.res());
        let [p, q, r, s] = self.data().unwrap_or([e, f, g, h]);
        match *self {
            Self::State { outcome: Ok(state), .. } => {
                let [p, q, r, s, t, u] = state.to_bytes();
                [code, res, p, q, r, s, t, u]
            }
            Self::ConfigurationModified { key, .. } | Self::Configuration { key, .. } => {
                [code, key.conf_type, key.conf_id, res, p, q, r, s]
            }
            Self::ParameterModified { para_id: selector, .. }
            | Self::Parameter { para_id: selector, .. }
            | Self::Indicator { ind_id: selector, .. }
            | Self::Calibrated { calibration: Calibration(selector), .. } => {
                [code, selector, res, d, p, q, r, s]
            }
            Self::Fault(Ok(fault)) => [code, res, fault.0, d, p, q, r, s],
            _ => [code, res, c, d, p, q, r, s],
        }
    }

    /// Returns the value in the last four bytes, for the replies that have one there.
    fn data(&self) -> Option<[u8; 4]> {
        match *self {
            Self::Configuration { outcome: Ok(value), .. } => Some(value.to_bytes()),
            Self::Parameter { outcome: Ok(value), .. } | Self::Version(Ok(value)) => {
                Some(value.to_le_bytes())
            }
            Self::Indicator { outcome: Ok(value), .. } => Some(value.to_bytes()),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scales() -> Scales {
        Scales::by_current(0.1, 8.0).unwrap()
    }

    /// Number of values of each request that its reply repeats: 3.2.3, 3.2.4, 3.2.12, 3.2.13,
    /// 3.2.17, 3.2.18.
    #[test]
    fn reply_repeats_command_and_documented_numbers() {
        for code in 0..=u8::MAX {
            let repeated = match code {
                0x83 | 0x84 => 2,
                0xA1 | 0xA2 | 0xB4 | 0xB5 => 1,
                _ => 0,
            };
            let request = [code, 1, 2, 3, 4, 5, 6, 7];
            assert!(!repeats(&request, &[code.wrapping_add(2), 1, 2, 3, 4, 5, 6, 7]), "{code:#X}");
            for at in 1..8 {
                let mut reply = request;
                reply[at] ^= 0x80;
                assert_eq!(repeats(&request, &reply), at > repeated, "{code:#X}, byte {at}");
            }
            assert!(!repeats(&request, &request[..7]) && !repeats(&request[..7], &request));
        }
        assert!(repeats(&[0xB5, 1, 0, 0, 0, 0, 0, 0], &[0xB4, 1, 0, 0, 0, 0, 0, 0]), "as printed");
        assert!(!repeats(&[0xB5, 1, 0, 0, 0, 0, 0, 0], &[0xB4, 2, 0, 0, 0, 0, 0, 0]));
    }

    #[test]
    fn every_truncated_and_oversized_reply_is_refused() {
        for received in (0..8).chain(9..=64) {
            let refused = DecodeError::Length { least: 8, most: 8, received };
            let reply = decode_reply(&[0x91; 64][..received], Pending::Other, &scales());
            assert_eq!(reply, Err(refused));
        }
    }

    #[test]
    fn indicator_byte_is_calibration_only_while_pending() {
        let printed = [0xB4, 1, 0, 0, 0, 0, 0, 0];
        let own = [0xB5, 1, 0, 0, 0, 0, 0, 0];
        let encoder = Command::Calibration(Calibration::ENCODER);
        let iq = Command::RetrieveIndicator { ind_id: 1 };
        for (bytes, pending, calibrates) in [
            (printed, Pending::Calibration, true),
            (printed, Pending::Other, false),
            (own, Pending::Calibration, true),
            (own, Pending::Other, true),
        ] {
            let reply = decode_reply(&bytes, pending, &scales()).unwrap();
            assert_eq!((reply.answers(&encoder), reply.answers(&iq)), (calibrates, !calibrates));
            assert_eq!(reply.encode_over([0; 8]), bytes);
        }
    }

    #[test]
    fn reply_with_other_number_is_no_answer() {
        let reply = decode_reply(&[0xA2, 6, 0, 0, 1, 0, 0, 0], Pending::Other, &scales()).unwrap();
        assert!(reply.answers(&Command::RetrieveParameter { para_id: 6 }));
        assert!(!reply.answers(&Command::RetrieveParameter { para_id: 5 }));
        assert!(!reply.answers(&Command::GetFault));
        let reply = decode_reply(&[0x84, 1, 3, 0, 0, 0, 0, 0], Pending::Other, &scales()).unwrap();
        assert!(
            reply.answers(&Command::RetrieveConfiguration(ConfigurationKey { conf_type: 1, conf_id: 3 }))
        );
        assert!(
            !reply.answers(&Command::RetrieveConfiguration(ConfigurationKey { conf_type: 0, conf_id: 3 }))
        );
    }

    #[test]
    fn values_beside_a_refusal_are_not_used() {
        for (bytes, refusal) in [
            ([0x93, 0x01, 1, 2, 3, 4, 5, 6], Refusal::Failure),
            ([0x84, 0x07, 0x03, 0x07, 0, 0, 0xC0, 0x7F], Refusal::DataFormat),
            ([0xA2, 0x06, 0x03, 0, 1, 2, 3, 4], Refusal::UnknownId),
            ([0xB1, 0x01, 0, 0, 1, 2, 3, 4], Refusal::Failure),
            ([0xB2, 0x01, 0x08, 0, 0, 0, 0, 0], Refusal::Failure),
            ([0xB4, 0x13, 0x80, 0, 0, 0, 0xC0, 0x7F], Refusal::Unlisted(0x80)),
        ] {
            let reply = decode_reply(&bytes, Pending::Other, &scales()).unwrap();
            assert_eq!(reply.res(), refusal.code());
            assert_eq!(reply.encode_over(bytes), bytes);
            assert_eq!(reply.data(), None);
        }
    }

    #[test]
    fn a_value_that_is_not_finite_is_refused() {
        let refused = Err(DecodeError::NotFinite { received: 0xFF80_0000 });
        for bytes in [[0xB4, 0x13, 0, 0, 0, 0, 0x80, 0xFF], [0x84, 0x01, 0x03, 0, 0, 0, 0x80, 0xFF]] {
            assert_eq!(decode_reply(&bytes, Pending::Other, &scales()), refused);
        }
        let unknown = decode_reply(&[0x84, 0x02, 0x03, 0, 0, 0, 0, 0], Pending::Other, &scales());
        assert_eq!(unknown, Err(DecodeError::UnknownType { received: 2 }));
    }

    #[test]
    fn every_reported_code_survives_a_round_trip() {
        for code in 0..=u16::MAX {
            let codes = StateCodes { position: code, velocity: code >> 4, torque: code & 0x0FFF };
            let state = State::new(code as i8, codes, &scales());
            let reply = Reply::State { command: CommandCode::TorqueControl, outcome: Ok(state) };
            assert_eq!(decode_reply(&reply.encode_over([0xA5; 8]), Pending::Other, &scales()), Ok(reply));
        }
    }
}
