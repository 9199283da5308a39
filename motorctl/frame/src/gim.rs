//! GIM commands and replies, over CAN.

use crate::member::{Member, Variants, variants};
use crate::mit;
use crate::null_bytes;
use crate::object::Object;
use crate::options::AnsweredCommand;
use crate::rejected::Rejected;
use motord_protocol::DecodeError;
use motord_protocol::gim::{
    self, Command, CommandCode, ConfigurationKey, Indicator, Parameter, Pending, Reply,
};

variants! { Command, by CommandCode;
    CommandCode::ResetConfiguration => ResetConfiguration {},
    CommandCode::RefreshConfiguration => RefreshConfiguration {},
    CommandCode::ModifyConfiguration => ModifyConfiguration { conf_id: conf_id, value: value },
    CommandCode::RetrieveConfiguration => RetrieveConfiguration { 0: key },
    CommandCode::StartMotor => StartMotor {},
    CommandCode::StopMotor => StopMotor {},
    CommandCode::TorqueControl => TorqueControl { torque: torque_nm, duration: duration_ms },
    CommandCode::SpeedControl => SpeedControl { speed_rpm: speed_rpm, duration: duration_ms },
    CommandCode::PositionControl => PositionControl { position: position_rad, duration: duration_ms },
    CommandCode::PtsControl => PtsControl {},
    CommandCode::StopControl => StopControl {},
    CommandCode::ModifyParameter => ModifyParameter { para_id: para_id, value: value },
    CommandCode::RetrieveParameter => RetrieveParameter { para_id: para_id },
    CommandCode::GetVersion => GetVersion {},
    CommandCode::GetFault => GetFault {},
    CommandCode::AcknowledgeFault => AcknowledgeFault {},
    CommandCode::RetrieveIndicator => RetrieveIndicator { ind_id: ind_id },
    CommandCode::Calibration => Calibration { 0: cali_type },
    CommandCode::UpdateFirmware => UpdateFirmware {},
}

variants! { Reply, by Option<CommandCode>;
    None => Unknown { command: cmd, outcome: none },
    Some(CommandCode::TorqueControl | CommandCode::SpeedControl | CommandCode::PositionControl) => State { command: cmd, outcome: state },
    Some(CommandCode::ModifyConfiguration) => ConfigurationModified { key: key, outcome: none },
    Some(CommandCode::RetrieveConfiguration) => Configuration { key: key, outcome: value },
    Some(CommandCode::ModifyParameter) => ParameterModified { para_id: para_id, outcome: none },
    Some(CommandCode::RetrieveParameter) => Parameter { para_id: para_id, outcome: value },
    Some(CommandCode::GetVersion) => Version { 0: version },
    Some(CommandCode::GetFault) => Fault { 0: fault },
    Some(CommandCode::RetrieveIndicator) => Indicator { ind_id: ind_id, outcome: value },
    Some(CommandCode::Calibration) => Calibrated { calibration: cali_type, outcome: none, echo: cmd },
    Some(_) => Done { command: cmd, outcome: none },
}

const KINDS: [(CommandCode, &str); CommandCode::ALL.len()] = [
    (CommandCode::ResetConfiguration, "reset_configuration"),
    (CommandCode::RefreshConfiguration, "refresh_configuration"),
    (CommandCode::ModifyConfiguration, "modify_configuration"),
    (CommandCode::RetrieveConfiguration, "retrieve_configuration"),
    (CommandCode::StartMotor, "start_motor"),
    (CommandCode::StopMotor, "stop_motor"),
    (CommandCode::TorqueControl, "torque_control"),
    (CommandCode::SpeedControl, "speed_control"),
    (CommandCode::PositionControl, "position_control"),
    (CommandCode::PtsControl, "pts_control"),
    (CommandCode::StopControl, "stop_control"),
    (CommandCode::ModifyParameter, "modify_parameter"),
    (CommandCode::RetrieveParameter, "retrieve_parameter"),
    (CommandCode::GetVersion, "get_version"),
    (CommandCode::GetFault, "get_fault"),
    (CommandCode::AcknowledgeFault, "acknowledge_fault"),
    (CommandCode::RetrieveIndicator, "retrieve_indicator"),
    (CommandCode::Calibration, "calibration"),
    (CommandCode::UpdateFirmware, "update_firmware"),
];

/// The key of the control frame that a motor in MIT mode reads from this command.
pub(super) const AS_MIT: &str = "as_mit";

/// The kind of an unlisted command.
const UNKNOWN: &str = "unknown";

fn kind_of(byte: u8) -> &'static str {
    KINDS.iter().find(|(code, _)| *code as u8 == byte).map_or(UNKNOWN, |(_, kind)| kind)
}

/// Returns the command of the object's kind; `None` for the kind `unknown`.
fn command_code(object: &Object) -> Result<Option<CommandCode>, Rejected> {
    let kind = object.kind()?;
    match KINDS.iter().find(|(_, known)| *known == kind) {
        Some((code, _)) => Ok(Some(*code)),
        None if kind == UNKNOWN => Ok(None),
        None => Err(Rejected::Kind { received: kind.into() }),
    }
}

/// Decodes a command into `object`.
pub(super) fn decode_command(bytes: &[u8], mut object: Object) -> Result<Object, Rejected> {
    let command = match gim::decode_command(bytes) {
        Err(DecodeError::UnknownCommand { received }) => {
            object.insert("kind", UNKNOWN);
            object.insert("cmd", received);
            null_bytes::write(&mut object, bytes, |filler| over_command(received, filler));
            return Ok(object);
        }
        command => command?,
    };
    object.insert("kind", kind_of(command.code() as u8));
    object.insert("cmd", command.code() as u8);
    command.write(&mut object);
    name_numbers(&mut object);
    null_bytes::write(&mut object, bytes, |filler| command.encode_over(filler));
    Ok(object)
}

/// Encodes a command. With `mit_safe` its free bytes make a motor in MIT mode read zero torque.
pub(super) fn encode_command(object: &Object, mit_safe: bool) -> Result<Vec<u8>, Rejected> {
    let filler = match object.object(AS_MIT) {
        Err(Rejected::Missing { .. }) => [0; 8],
        control => mit::command(&control?)?.encode(),
    };
    let Some(code) = command_code(object)? else {
        let command = object.byte("cmd")?;
        let fill = || null_bytes::fill(object, filler, 0, |filler| over_command(command, filler));
        return if mit_safe { Err(Rejected::NotMitSafe) } else { fill() };
    };
    let command = Command::read(code, object)?;
    if mit_safe {
        return Ok(command.encode_mit_safe().ok_or(Rejected::NotMitSafe)?.to_vec());
    }
    null_bytes::fill(object, filler, 0, |filler| command.encode_over(filler))
}

/// Decodes a reply into `object`.
pub(super) fn decode_reply(
    bytes: &[u8],
    asked: AnsweredCommand,
    mut object: Object,
) -> Result<Object, Rejected> {
    let pending = if asked == AnsweredCommand::Calibration { Pending::Calibration } else { Pending::Other };
    let reply = gim::decode_reply(bytes, pending, &object.scales()?)?;
    let is_calibration = matches!(reply, Reply::Calibrated { .. });
    object.insert("kind", if is_calibration { "calibration" } else { kind_of(reply.code()) });
    object.insert("cmd", reply.code());
    reply.write(&mut object);
    name_numbers(&mut object);
    null_bytes::write(&mut object, bytes, |filler| reply.encode_over(filler));
    Ok(object)
}

/// Encodes a reply.
pub(super) fn encode_reply(object: &Object) -> Result<Vec<u8>, Rejected> {
    let code = command_code(object)?;
    let mut object = object.clone();
    if let Some(code) = code.filter(|code| *code != CommandCode::Calibration) {
        object.insert("cmd", code as u8);
    }
    let reply = Reply::read(code, &object)?;
    null_bytes::fill(&object, [0; 8], 0, |filler| reply.encode_over(filler))
}

/// Encodes an unlisted command over `filler`.
fn over_command(command: u8, [_, rest @ ..]: [u8; 8]) -> [u8; 8] {
    let [b, c, d, e, f, g, h] = rest;
    [command, b, c, d, e, f, g, h]
}

/// Adds names and units from the vendor's tables.
fn name_numbers(object: &mut Object) {
    let key = ConfigurationKey::read(object, "").ok();
    if let Some(item) = key.and_then(ConfigurationKey::item) {
        object.insert("name", item.name);
        object.insert("unit", item.unit);
    }
    if let (Some(true), Ok(value)) = (key.map(ConfigurationKey::is_position), u32::read(object, "value")) {
        object.insert("position_rad", gim::single_turn_position(value as i32));
    }
    if let Some(parameter) = object.byte("para_id").ok().and_then(Parameter::by_id) {
        object.insert("name", parameter.name);
    }
    if let Some(indicator) = object.byte("ind_id").ok().and_then(Indicator::by_id) {
        object.insert("name", indicator.name);
        object.insert("unit", indicator.unit);
    }
    object.name_faults();
}
