//! MIT commands and replies.

use crate::frame::Asked;
use crate::frame::member::Member;
use crate::frame::null_bytes;
use crate::frame::object::{Object, Quantity};
use crate::frame::refused::Refused;
use motord_protocol::mit::{self, CommandCodes, ControlCodes};
use motord_protocol::{FaultBits, StateCodes};

/// Relatives of these motors append up to two bytes of their own to a reply.
const SURPLUS_MAX: usize = 2;

/// Decodes a command into `object`.
pub(super) fn decode_command(bytes: &[u8], mut object: Object) -> Result<Object, Refused> {
    let command = CommandCodes::decode(bytes)?;
    object.insert("kind", kind_of(&command));
    match command {
        CommandCodes::GetFault { f_cmd } => object.insert("f_cmd", f_cmd),
        CommandCodes::ClearFault => object.insert("f_cmd", 0xFF),
        CommandCodes::Control(ControlCodes { position, velocity, kp, kd, torque }) => {
            object.insert_code(&Quantity::KP, kp);
            object.insert_code(&Quantity::KD, kd);
            StateCodes { position, velocity, torque }.write(&mut object, "");
        }
        CommandCodes::Start | CommandCodes::Stop | CommandCodes::SetZero => {}
    }
    Ok(object)
}

fn kind_of(command: &CommandCodes) -> &'static str {
    match command {
        CommandCodes::GetFault { .. } => "get_fault",
        CommandCodes::ClearFault => "clear_fault",
        CommandCodes::Start => "start_motor",
        CommandCodes::Stop => "stop_motor",
        CommandCodes::SetZero => "set_zero",
        CommandCodes::Control(_) => "dynamic_control",
    }
}

/// The command that `object` describes.
pub(super) fn command(object: &Object) -> Result<CommandCodes, Refused> {
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
            let StateCodes { position, velocity, torque } = Member::read(object, "")?;
            let (kp, kd) = (object.code(&Quantity::KP)?, object.code(&Quantity::KD)?);
            CommandCodes::Control(ControlCodes { position, velocity, kp, kd, torque })
        }
        received => return Err(Refused::Kind { received: received.into() }),
    })
}

/// Decodes a reply into `object`.
pub(super) fn decode_reply(bytes: &[u8], asked: Asked, mut object: Object) -> Result<Object, Refused> {
    let asked = match asked {
        Asked::GetFault => mit::Asked::Fault,
        Asked::ClearFault => mit::Asked::Clear,
        Asked::State | Asked::Calibration => mit::Asked::State,
    };
    let reply = mit::decode_reply(bytes, asked, &object.torque_scale()?)?;
    match reply {
        mit::Reply::State(state) => {
            object.insert("kind", "state");
            state.codes.write(&mut object, "");
        }
        mit::Reply::Fault { fault, .. } => {
            object.insert("kind", "fault_reply");
            fault.write(&mut object, "fault");
            object.name_faults();
        }
        mit::Reply::Cleared { .. } => object.insert("kind", "clear_fault_reply"),
    }
    object.insert("can_id", reply.id());
    null_bytes::write(&mut object, bytes, |filler| reply.encode_over(filler));
    Ok(object)
}

/// Encodes a reply.
pub(super) fn encode_reply(object: &Object) -> Result<Vec<u8>, Refused> {
    let id = object.byte("can_id")?;
    let reply = match object.kind()? {
        "state" => mit::Reply::State(mit::State::new(id, Member::read(object, "")?, &object.torque_scale()?)),
        "fault_reply" => mit::Reply::Fault { id, fault: FaultBits::read(object, "fault")? },
        "clear_fault_reply" => mit::Reply::Cleared { id },
        received => return Err(Refused::Kind { received: received.into() }),
    };
    null_bytes::fill(object, [0; 6], SURPLUS_MAX, |filler| reply.encode_over(filler))
}
