//! Bytes to the object that tells what they mean.

use crate::frame::object::{Object, Quantity};
use crate::frame::refused::Refused;
use crate::frame::scale::Scale;
use crate::frame::{Asked, Direction, Protocol, Reading, encode, hex, kind, scale};
use motord_protocol::gim::{self, ConfigurationKey, Indicator, Parameter, Pending, Value};
use motord_protocol::mit::{self, CommandCodes, ControlCodes};
use motord_protocol::rs485::{self, FrameType};
use motord_protocol::{DecodeError, FaultBits, StateCodes};

/// What the bytes of one frame mean.
pub(super) fn decode(bytes: &[u8], reading: &Reading) -> Result<Object, Refused> {
    match (reading.protocol, reading.direction) {
        (Protocol::Mit, Direction::ToMotor) => mit_command(bytes, reading.scale.as_ref()),
        (Protocol::Mit, Direction::ToHost) => mit_reply(bytes, reading),
        (Protocol::GimCan, Direction::ToMotor) => gim_command(bytes),
        (Protocol::GimCan, Direction::ToHost) => gim_reply(bytes, reading),
        (Protocol::GimRs485, _) => serial(bytes, reading),
    }
}

fn mit_command(bytes: &[u8], scale: Option<&Scale>) -> Result<Object, Refused> {
    let mut object;
    match CommandCodes::decode(bytes)? {
        CommandCodes::GetFault { f_cmd } => {
            object = Object::of_kind("get_fault");
            object.insert("f_cmd", f_cmd);
        }
        CommandCodes::ClearFault => {
            object = Object::of_kind("clear_fault");
            object.insert("f_cmd", 0xFF);
        }
        CommandCodes::Start => object = Object::of_kind("start_motor"),
        CommandCodes::Stop => object = Object::of_kind("stop_motor"),
        CommandCodes::SetZero => object = Object::of_kind("set_zero"),
        CommandCodes::Control(ControlCodes { position, velocity, kp, kd, torque }) => {
            object = Object::of_kind("dynamic_control");
            object.tell(&Quantity::KP, kp);
            object.tell(&Quantity::KD, kd);
            tell_state(&mut object, StateCodes { position, velocity, torque }, scale);
        }
    }
    Ok(object)
}

fn tell_state(object: &mut Object, codes: StateCodes, scale: Option<&Scale>) {
    object.tell(&Quantity::POSITION, codes.position);
    object.tell(&Quantity::VELOCITY, codes.velocity);
    object.tell(&Quantity::torque(scale), codes.torque);
    if let Some(scale) = scale {
        scale.tell(object);
    }
}

fn mit_reply(bytes: &[u8], reading: &Reading) -> Result<Object, Refused> {
    let asked = match reading.asked {
        Asked::GetFault => mit::Asked::Fault,
        Asked::ClearFault => mit::Asked::Clear,
        Asked::State | Asked::Calibration => mit::Asked::State,
    };
    let reply = mit::decode_reply(bytes, asked, &scale::torque_or_any(reading.scale.as_ref())?)?;
    let mut object;
    match reply {
        mit::Reply::State(state) => {
            object = Object::of_kind("state");
            tell_state(&mut object, state.codes, reading.scale.as_ref());
        }
        mit::Reply::Fault { fault, .. } => {
            object = Object::of_kind("fault_reply");
            tell_fault(&mut object, fault);
        }
        mit::Reply::Cleared { .. } => object = Object::of_kind("clear_fault_reply"),
    }
    object.insert("can_id", reply.id());
    tell_null_bytes(&mut object, bytes, |filler| reply.encode_over(filler));
    Ok(object)
}

fn tell_fault(object: &mut Object, fault: FaultBits) {
    object.insert("fault", fault.0);
    object.insert("faults", fault.named().map(|fault| fault.name).collect::<Vec<_>>());
}

/// Tells the bytes without a meaning, in their order, if there is anything in them or more of them than needed.
fn tell_null_bytes<const N: usize>(
    object: &mut Object,
    bytes: &[u8],
    encode_over: impl Fn([u8; N]) -> [u8; N],
) {
    let null = is_null(encode_over);
    let is_free = |(at, _): &(usize, &u8)| null.get(*at).is_none_or(|&is_null| is_null);
    let free: Vec<u8> = bytes.iter().enumerate().filter(is_free).map(|(_, &byte)| byte).collect();
    if bytes.len() > N || free.iter().any(|&byte| byte != 0) {
        object.insert("null_bytes", hex::digits(&free));
    }
}

/// Which bytes have no meaning: those where a filler shows through.
pub(super) fn is_null<const N: usize>(encode_over: impl Fn([u8; N]) -> [u8; N]) -> [bool; N] {
    let (zeros, ones) = (encode_over([0x00; N]), encode_over([0xFF; N]));
    core::array::from_fn(|at| zeros[at] != ones[at])
}

fn gim_command(bytes: &[u8]) -> Result<Object, Refused> {
    let command = match gim::decode_command(bytes) {
        Err(DecodeError::UnknownCommand { received }) => return Ok(unknown_command(received, bytes)),
        command => command?,
    };
    let code = command.code() as u8;
    let mut object = Object::of_kind(kind::name(code));
    object.insert("cmd", code);
    match command {
        gim::Command::ModifyConfiguration { conf_id, value } => {
            tell_key(&mut object, ConfigurationKey::new(value.value_type(), conf_id));
            tell_value(&mut object, ConfigurationKey::new(value.value_type(), conf_id), value);
        }
        gim::Command::RetrieveConfiguration(key) => tell_key(&mut object, key),
        gim::Command::TorqueControl { torque, duration } => {
            object.insert("torque_nm", torque.get());
            object.insert("duration_ms", duration.as_millis());
        }
        gim::Command::SpeedControl { speed_rpm, duration } => {
            object.insert("speed_rpm", speed_rpm.get());
            object.insert("duration_ms", duration.as_millis());
        }
        gim::Command::PositionControl { position, duration } => {
            object.insert("position_rad", position.get());
            object.insert("duration_ms", duration.as_millis());
        }
        gim::Command::ModifyParameter { para_id, value } => {
            tell_parameter(&mut object, para_id);
            object.insert("value", value);
        }
        gim::Command::RetrieveParameter { para_id } => tell_parameter(&mut object, para_id),
        gim::Command::RetrieveIndicator { ind_id } => tell_indicator(&mut object, ind_id),
        gim::Command::Calibration(calibration) => object.insert("cali_type", calibration.0),
        _ => {}
    }
    tell_null_bytes(&mut object, bytes, |filler| command.encode_over(filler));
    Ok(object)
}

fn unknown_command(command: u8, bytes: &[u8]) -> Object {
    let mut object = Object::of_kind(kind::UNKNOWN);
    object.insert("cmd", command);
    tell_null_bytes(&mut object, bytes, |[_, rest @ ..]: [u8; 8]| over_command(command, rest));
    object
}

/// A frame of which only the command has a meaning.
pub(super) fn over_command(command: u8, rest: [u8; 7]) -> [u8; 8] {
    let [b, c, d, e, f, g, h] = rest;
    [command, b, c, d, e, f, g, h]
}

fn tell_key(object: &mut Object, key: ConfigurationKey) {
    object.insert("conf_type", key.conf_type);
    object.insert("conf_id", key.conf_id);
    if let Some(item) = key.item() {
        object.insert("name", item.name);
        object.insert("unit", item.unit);
    }
}

fn tell_value(object: &mut Object, key: ConfigurationKey, value: Value) {
    match value {
        Value::Integer(value) => {
            object.insert("value", value);
            if key.is_position() {
                object.insert("position_rad", gim::single_turn_position(value));
            }
        }
        Value::Float(value) => object.insert("value", value.get()),
    }
}

fn tell_parameter(object: &mut Object, para_id: u8) {
    object.insert("para_id", para_id);
    if let Some(parameter) = Parameter::by_id(para_id) {
        object.insert("name", parameter.name);
    }
}

fn tell_indicator(object: &mut Object, ind_id: u8) {
    object.insert("ind_id", ind_id);
    if let Some(indicator) = Indicator::by_id(ind_id) {
        object.insert("name", indicator.name);
        object.insert("unit", indicator.unit);
    }
}

fn gim_reply(bytes: &[u8], reading: &Reading) -> Result<Object, Refused> {
    let pending = if reading.asked == Asked::Calibration { Pending::Calibration } else { Pending::Other };
    let reply = gim::decode_reply(bytes, pending, &scale::torque_or_any(reading.scale.as_ref())?)?;
    let kind = match reply {
        gim::Reply::Calibrated { .. } => "calibration",
        _ => kind::name(reply.code()),
    };
    let mut object = Object::of_kind(kind);
    object.insert("cmd", reply.code());
    object.insert("res", reply.res());
    tell_reply(&mut object, &reply, reading.scale.as_ref());
    tell_null_bytes(&mut object, bytes, |filler| reply.encode_over(filler));
    Ok(object)
}

/// What a reply tells beside how the command went.
fn tell_reply(object: &mut Object, reply: &gim::Reply, scale: Option<&Scale>) {
    match *reply {
        gim::Reply::State { outcome: Ok(state), .. } => {
            object.insert("temperature_c", state.temperature_celsius);
            tell_state(object, state.codes, scale);
        }
        gim::Reply::ConfigurationModified { key, .. } => tell_key(object, key),
        gim::Reply::Configuration { key, outcome } => {
            tell_key(object, key);
            if let Ok(value) = outcome {
                tell_value(object, key, value);
            }
        }
        gim::Reply::ParameterModified { para_id, .. } => tell_parameter(object, para_id),
        gim::Reply::Parameter { para_id, outcome } => {
            tell_parameter(object, para_id);
            if let Ok(value) = outcome {
                object.insert("value", value);
            }
        }
        gim::Reply::Version(Ok(version)) => object.insert("version", version),
        gim::Reply::Fault(Ok(fault)) => tell_fault(object, fault),
        gim::Reply::Indicator { ind_id, outcome } => {
            tell_indicator(object, ind_id);
            if let Ok(value) = outcome {
                object.insert("value", value.get());
            }
        }
        gim::Reply::Calibrated { calibration, .. } => object.insert("cali_type", calibration.0),
        _ => {}
    }
}

fn serial(bytes: &[u8], reading: &Reading) -> Result<Object, Refused> {
    let frame = rs485::Frame::decode(bytes)?;
    let payload = frame.payload();
    let mut object = match (frame.frame_type(), reading.direction) {
        (FrameType::Ack, _) => Object::of_kind(encode::ACK),
        (FrameType::Normal, Direction::ToMotor) => gim_command(payload)?,
        (FrameType::Normal, Direction::ToHost) => gim_reply(payload, reading)?,
    };
    let [id, frame_type, len, crc] = frame.header();
    object.insert("header", serde_json::json!({ "id": id, "type": frame_type, "len": len, "crc": crc }));
    if !payload.is_empty() {
        object.insert("payload", hex::digits(payload));
    }
    Ok(object)
}
