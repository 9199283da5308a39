//! The object that tells what a frame means to its bytes.

use crate::frame::decode::{self, is_null, over_command};
use crate::frame::object::{Object, Quantity};
use crate::frame::refused::Refused;
use crate::frame::scale::Scale;
use crate::frame::{Asked, Direction, Protocol, Reading, kind, scale};
use motord_protocol::gim::{
    self, Calibration, CommandCode, ConfigurationKey, ExecutionTime, Finite, Outcome, Refusal, Value,
    ValueType,
};
use motord_protocol::mit::{self, CommandCodes, ControlCodes};
use motord_protocol::{DecodeError, FaultBits, StateCodes, rs485};
use serde_json::Value as Json;
use std::f64::consts::TAU;

/// The kind of a serial frame that says a request could not be read.
pub(super) const ACK: &str = "ack_error";

/// The bytes of the frame that `object` tells of.
pub(super) fn encode(object: &Object, reading: &Reading, mit_safe: bool) -> Result<Vec<u8>, Refused> {
    let scale = Scale::of(object)?.or(reading.scale);
    match (reading.protocol, reading.direction) {
        (Protocol::Mit, Direction::ToMotor) => Ok(mit_command(object, scale.as_ref())?.encode().to_vec()),
        (Protocol::Mit, Direction::ToHost) => mit_reply(object, scale.as_ref()),
        (Protocol::GimCan, Direction::ToMotor) => gim_command(object, mit_safe),
        (Protocol::GimCan, Direction::ToHost) => gim_reply(object, scale.as_ref()),
        (Protocol::GimRs485, _) => serial(object, reading, mit_safe),
    }
}

fn unknown_kind<T>(object: &Object) -> Result<T, Refused> {
    Err(Refused::Kind { received: object.kind()?.into() })
}

fn mit_command(object: &Object, scale: Option<&Scale>) -> Result<CommandCodes, Refused> {
    Ok(match object.kind()? {
        "get_fault" if object.has("f_cmd") => {
            CommandCodes::GetFault { f_cmd: object.integer("f_cmd", 0, 0xFE)? as u8 }
        }
        "get_fault" => CommandCodes::GetFault { f_cmd: 0 },
        "clear_fault" => CommandCodes::ClearFault,
        "start_motor" => CommandCodes::Start,
        "stop_motor" => CommandCodes::Stop,
        "set_zero" => CommandCodes::SetZero,
        "dynamic_control" => {
            let StateCodes { position, velocity, torque } = state_codes(object, scale)?;
            let (kp, kd) = (object.code(&Quantity::KP)?, object.code(&Quantity::KD)?);
            CommandCodes::Control(ControlCodes { position, velocity, kp, kd, torque })
        }
        _ => return unknown_kind(object),
    })
}

fn state_codes(object: &Object, scale: Option<&Scale>) -> Result<StateCodes, Refused> {
    Ok(StateCodes {
        position: object.code(&Quantity::POSITION)?,
        velocity: object.code(&Quantity::VELOCITY)?,
        torque: object.code(&Quantity::torque(scale))?,
    })
}

fn mit_reply(object: &Object, scale: Option<&Scale>) -> Result<Vec<u8>, Refused> {
    let id = object.byte("can_id")?;
    let reply = match object.kind()? {
        "state" => {
            mit::Reply::State(mit::State::new(id, state_codes(object, scale)?, &scale::torque_or_any(scale)?))
        }
        "fault_reply" => mit::Reply::Fault { id, fault: FaultBits(object.byte("fault")?) },
        "clear_fault_reply" => mit::Reply::Cleared { id },
        _ => return unknown_kind(object),
    };
    // Relatives of these motors append up to two bytes of their own.
    fill(object, [0; 6], 2, |filler| reply.encode_over(filler))
}

/// The frame's bytes. Those without a meaning are the object's `null_bytes`, of which `surplus` may follow the frame;
/// without such a key they are those of `filler`.
fn fill<const N: usize>(
    object: &Object,
    filler: [u8; N],
    surplus: usize,
    encode_over: impl Fn([u8; N]) -> [u8; N],
) -> Result<Vec<u8>, Refused> {
    if !object.has("null_bytes") {
        return Ok(encode_over(filler).to_vec());
    }
    let told = object.bytes("null_bytes")?;
    let null = is_null(&encode_over);
    let room = null.iter().filter(|&&is_null| is_null).count();
    if !(room..=room + surplus).contains(&told.len()) {
        return Err(Refused::NullBytes { least: room, most: room + surplus, received: told.len() });
    }
    let mut told = told.into_iter();
    let filler = null.map(|is_null| if is_null { told.next().unwrap_or(0) } else { 0 });
    Ok(encode_over(filler).into_iter().chain(told).collect())
}

fn gim_command(object: &Object, mit_safe: bool) -> Result<Vec<u8>, Refused> {
    let filler = match object.object("as_mit") {
        Err(Refused::Missing { .. }) => [0; 8],
        control => mit_command(&control?, None)?.encode(),
    };
    let command = match object.kind()? {
        kind::UNKNOWN if mit_safe => return Err(Refused::NotMitSafe),
        kind::UNKNOWN => {
            let command = object.byte("cmd")?;
            return fill(object, filler, 0, |[_, rest @ ..]| over_command(command, rest));
        }
        _ => native_command(object)?,
    };
    if mit_safe {
        return Ok(command.encode_mit_safe().ok_or(Refused::NotMitSafe)?.to_vec());
    }
    fill(object, filler, 0, |filler| command.encode_over(filler))
}

fn command_code(object: &Object) -> Result<CommandCode, Refused> {
    kind::code(object.kind()?).map_or_else(|| unknown_kind(object), Ok)
}

fn native_command(object: &Object) -> Result<gim::Command, Refused> {
    use gim::Command;
    Ok(match command_code(object)? {
        CommandCode::ResetConfiguration => Command::ResetConfiguration,
        CommandCode::RefreshConfiguration => Command::RefreshConfiguration,
        CommandCode::ModifyConfiguration => {
            let key = key(object)?;
            Command::ModifyConfiguration { conf_id: key.conf_id, value: value(object, key)? }
        }
        CommandCode::RetrieveConfiguration => Command::RetrieveConfiguration(key(object)?),
        CommandCode::StartMotor => Command::StartMotor,
        CommandCode::StopMotor => Command::StopMotor,
        CommandCode::TorqueControl => {
            Command::TorqueControl { torque: finite(object, "torque_nm")?, duration: duration(object)? }
        }
        CommandCode::SpeedControl => {
            Command::SpeedControl { speed_rpm: finite(object, "speed_rpm")?, duration: duration(object)? }
        }
        CommandCode::PositionControl => Command::PositionControl {
            position: finite(object, "position_rad")?,
            duration: duration(object)?,
        },
        CommandCode::PtsControl => Command::PtsControl,
        CommandCode::StopControl => Command::StopControl,
        CommandCode::ModifyParameter => {
            Command::ModifyParameter { para_id: object.byte("para_id")?, value: word(object, "value")? }
        }
        CommandCode::RetrieveParameter => Command::RetrieveParameter { para_id: object.byte("para_id")? },
        CommandCode::GetVersion => Command::GetVersion,
        CommandCode::GetFault => Command::GetFault,
        CommandCode::AcknowledgeFault => Command::AcknowledgeFault,
        CommandCode::RetrieveIndicator => Command::RetrieveIndicator { ind_id: object.byte("ind_id")? },
        CommandCode::Calibration => Command::Calibration(Calibration(object.byte("cali_type")?)),
        CommandCode::UpdateFirmware => Command::UpdateFirmware,
    })
}

fn key(object: &Object) -> Result<ConfigurationKey, Refused> {
    Ok(ConfigurationKey { conf_type: object.byte("conf_type")?, conf_id: object.byte("conf_id")? })
}

fn value(object: &Object, key: ConfigurationKey) -> Result<Value, Refused> {
    match ValueType::from_byte(key.conf_type) {
        Some(ValueType::Integer) if key.is_position() && !object.has("value") => {
            let turns = object.number("position_rad")? / TAU;
            Ok(Value::Integer((turns.rem_euclid(1.0) * 65536.0).round() as i32 % 65536))
        }
        Some(ValueType::Integer) => {
            let value = object.integer("value", i32::MIN.into(), i32::MAX.into())?;
            Ok(Value::Integer(value as i32))
        }
        Some(ValueType::Float) => Ok(Value::Float(finite(object, "value")?)),
        None => Err(DecodeError::UnknownType { received: key.conf_type }.into()),
    }
}

fn finite(object: &Object, key: &'static str) -> Result<Finite, Refused> {
    let number = object.number(key)?;
    let refused = || Refused::Type { key, expected: "a float of 32 bits", received: number.to_string() };
    Finite::new(number as f32).ok_or_else(refused)
}

fn duration(object: &Object) -> Result<ExecutionTime, Refused> {
    let key = "duration_ms";
    let most = i64::from(ExecutionTime::MAX.as_millis());
    let millis = object.integer(key, 0, most)?;
    let refused = || Refused::Range { key, least: 0, most, received: millis.to_string() };
    ExecutionTime::from_millis(millis as u32).ok_or_else(refused)
}

fn word(object: &Object, key: &'static str) -> Result<u32, Refused> {
    Ok(object.integer(key, 0, u32::MAX.into())? as u32)
}

fn gim_reply(object: &Object, scale: Option<&Scale>) -> Result<Vec<u8>, Refused> {
    let outcome = Refusal::check(object.byte("res")?);
    let reply = match object.kind()? {
        kind::UNKNOWN => gim::Reply::Unknown { command: object.byte("cmd")?, outcome },
        _ => native_reply(object, outcome, scale)?,
    };
    fill(object, [0; 8], 0, |filler| reply.encode_over(filler))
}

fn native_reply(object: &Object, outcome: Outcome<()>, scale: Option<&Scale>) -> Result<gim::Reply, Refused> {
    use gim::Reply;
    let command = command_code(object)?;
    Ok(match command {
        CommandCode::TorqueControl | CommandCode::SpeedControl | CommandCode::PositionControl => {
            Reply::State { command, outcome: with(outcome, || native_state(object, scale))? }
        }
        CommandCode::ModifyConfiguration => Reply::ConfigurationModified { key: key(object)?, outcome },
        CommandCode::RetrieveConfiguration => {
            let key = key(object)?;
            Reply::Configuration { key, outcome: with(outcome, || value(object, key))? }
        }
        CommandCode::ModifyParameter => {
            Reply::ParameterModified { para_id: object.byte("para_id")?, outcome }
        }
        CommandCode::RetrieveParameter => Reply::Parameter {
            para_id: object.byte("para_id")?,
            outcome: with(outcome, || word(object, "value"))?,
        },
        CommandCode::GetVersion => Reply::Version(with(outcome, || word(object, "version"))?),
        CommandCode::GetFault => Reply::Fault(with(outcome, || Ok(FaultBits(object.byte("fault")?)))?),
        CommandCode::RetrieveIndicator => Reply::Indicator {
            ind_id: object.byte("ind_id")?,
            outcome: with(outcome, || finite(object, "value"))?,
        },
        CommandCode::Calibration => Reply::Calibrated {
            calibration: Calibration(object.byte("cali_type")?),
            outcome,
            echo: calibration_echo(object)?,
        },
        _ => Reply::Done { command, outcome },
    })
}

/// Reads a value only where the motor tells success.
fn with<T>(outcome: Outcome<()>, value: impl FnOnce() -> Result<T, Refused>) -> Result<Outcome<T>, Refused> {
    outcome.map(|()| value()).map_or_else(|refusal| Ok(Err(refusal)), |value| value.map(Ok))
}

fn native_state(object: &Object, scale: Option<&Scale>) -> Result<gim::State, Refused> {
    let temperature = object.integer("temperature_c", i8::MIN.into(), i8::MAX.into())? as i8;
    Ok(gim::State::new(temperature, state_codes(object, scale)?, &scale::torque_or_any(scale)?))
}

/// The byte a calibration's reply begins with: as the document prints it, if `cmd` does not say otherwise.
fn calibration_echo(object: &Object) -> Result<CommandCode, Refused> {
    let echo = if object.has("cmd") { object.byte("cmd")? } else { CommandCode::RetrieveIndicator as u8 };
    match CommandCode::from_byte(echo)? {
        echo @ (CommandCode::RetrieveIndicator | CommandCode::Calibration) => Ok(echo),
        _ => Err(Refused::Range { key: "cmd", least: 0xB4, most: 0xB5, received: echo.to_string() }),
    }
}

fn serial(object: &Object, reading: &Reading, mit_safe: bool) -> Result<Vec<u8>, Refused> {
    let receiver = object.object("header")?.byte("id")?;
    let payload = match (object.has("payload"), reading.direction) {
        (true, _) => object.bytes("payload")?,
        (false, _) if object.kind()? == ACK => Vec::new(),
        (false, Direction::ToMotor) => gim_command(object, mit_safe)?,
        (false, Direction::ToHost) => gim_reply(object, Scale::of(object)?.or(reading.scale).as_ref())?,
    };
    let frame = if object.kind()? == ACK {
        rs485::Frame::ack(receiver, &payload)
    } else {
        assert_payload(object, &payload, reading)?;
        payload[..].try_into().ok().map(|payload| rs485::Frame::normal(receiver, payload))
    };
    let frame = frame.ok_or(DecodeError::Length { least: 0, most: 8, received: payload.len() })?;
    Ok(frame.write(&mut [0; rs485::FRAME_LEN_MAX]).to_vec())
}

/// An object that tells both a payload and what it means must not tell two things.
fn assert_payload(object: &Object, payload: &[u8], reading: &Reading) -> Result<(), Refused> {
    let asked = if object.kind()? == "calibration" { Asked::Calibration } else { Asked::State };
    let told = decode::decode(payload, &Reading { protocol: Protocol::GimCan, asked, ..*reading })?;
    let is_same = |told: &Json, given: &Json| {
        told == given || told.as_f64().is_some_and(|told| Some(told) == given.as_f64())
    };
    let differs = |(key, told): &(&String, &Json)| object.get(key).is_some_and(|given| !is_same(told, given));
    match told.entries().find(differs) {
        Some((key, _)) => Err(Refused::Payload { key: key.clone() }),
        None => Ok(()),
    }
}
