//! MIT commands and replies.

use crate::member::Member;
use crate::null_bytes;
use crate::object::Object;
use crate::options::AnsweredCommand;
use crate::rejected::Rejected;
use motord_protocol::mit::{self, CommandCodes, ControlCodes, Reply, State};
use motord_protocol::profile::FaultReport;
use motord_protocol::{Faults, Profile, StateCodes};
use motord_shared::Fault;
use serde_json::Value;

/// Decodes a command into `object`.
pub(super) fn decode_command(bytes: &[u8], mut object: Object) -> Result<Object, Rejected> {
    let command = object.profile().decode_codes(bytes)?;
    object.insert("kind", kind_of(&command));
    match command {
        CommandCodes::GetFault { f_cmd } => object.insert("f_cmd", f_cmd),
        CommandCodes::ClearFault => object.insert("f_cmd", 0xFF),
        CommandCodes::Control(ControlCodes { position, velocity, kp, kd, torque }) => {
            let quantities = object.quantities();
            object.insert_code(&quantities.kp, kp);
            object.insert_code(&quantities.kd, kd);
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

/// Returns the command that `object` describes.
pub(super) fn command(object: &Object) -> Result<CommandCodes, Rejected> {
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
            let quantities = object.quantities();
            let (kp, kd) = (object.code(&quantities.kp)?, object.code(&quantities.kd)?);
            CommandCodes::Control(ControlCodes { position, velocity, kp, kd, torque })
        }
        received => return Err(Rejected::Kind { received: received.into() }),
    })
}

/// Decodes a reply into `object`.
pub(super) fn decode_reply(
    bytes: &[u8],
    asked: AnsweredCommand,
    mut object: Object,
) -> Result<Object, Rejected> {
    let asked = match asked {
        AnsweredCommand::GetFault => mit::Asked::Fault,
        AnsweredCommand::ClearFault => mit::Asked::Clear,
        AnsweredCommand::State | AnsweredCommand::Calibration => mit::Asked::State,
    };
    let profile = object.profile();
    let reply = profile.decode(bytes, asked, &object.scales()?)?;
    match reply {
        Reply::State(state) => {
            object.insert("kind", "state");
            state.codes.write(&mut object, "");
            write_measured(&mut object, profile, &state);
        }
        Reply::Fault { number, faults, .. } => {
            object.insert("kind", "fault_reply");
            object.insert("fault", number);
            write_faults(&mut object, faults);
        }
        Reply::Cleared { .. } => object.insert("kind", "clear_fault_reply"),
    }
    object.insert("can_id", reply.id());
    match profile.known_bytes(&reply) {
        5 => null_bytes::write(&mut object, bytes, |filler| first::<5>(profile, &reply, filler)),
        6 => null_bytes::write(&mut object, bytes, |filler| first::<6>(profile, &reply, filler)),
        _ => null_bytes::write(&mut object, bytes, |filler| first::<8>(profile, &reply, filler)),
    }
    Ok(object)
}

/// Adds temperatures, status and faults of a state.
fn write_measured(object: &mut Object, profile: &Profile, state: &State) {
    let temperatures: Vec<_> = state.temperatures.into_iter().flatten().collect();
    if !temperatures.is_empty() {
        object.insert("temperatures_c", temperatures);
    }
    if let Some(status) = state.status {
        object.insert("status", status);
    }
    if let Some(faults) = profile.faults_of(state) {
        write_faults(object, faults);
    }
}

fn write_faults(object: &mut Object, faults: Faults) {
    object.insert("faults", Fault::of_bits(faults.0).map(Fault::name).collect::<Vec<_>>());
}

/// Returns the first bytes of `reply`, written over `filler`.
fn first<const N: usize>(profile: &Profile, reply: &Reply, filler: [u8; N]) -> [u8; N] {
    let mut bytes = [0; 8];
    bytes[..N].copy_from_slice(&filler);
    let bytes = profile.encode_over(reply, bytes).0;
    core::array::from_fn(|at| bytes[at])
}

/// Encodes a reply.
pub(super) fn encode_reply(object: &Object) -> Result<Vec<u8>, Rejected> {
    let profile = object.profile();
    let id = object.byte("can_id")?;
    let reply = match object.kind()? {
        "state" => Reply::State(state(object, id)?),
        "fault_reply" => {
            let number = object.integer("fault", 0, largest_fault(profile))? as u32;
            Reply::Fault { id, number, faults: Faults::NONE }
        }
        "clear_fault_reply" => Reply::Cleared { id },
        received => return Err(Rejected::Kind { received: received.into() }),
    };
    let known = profile.known_bytes(&reply);
    let surplus = 8 - known;
    match known {
        5 => null_bytes::fill(object, [0; 5], surplus, |filler| first::<5>(profile, &reply, filler)),
        6 => null_bytes::fill(object, [0; 6], surplus, |filler| first::<6>(profile, &reply, filler)),
        _ => null_bytes::fill(object, [0; 8], surplus, |filler| first::<8>(profile, &reply, filler)),
    }
}

fn state(object: &Object, id: u8) -> Result<State, Rejected> {
    let codes: StateCodes = Member::read(object, "")?;
    let [position, velocity, torque] = codes.scaled(&object.scales()?);
    let temperatures = object.get("temperatures_c").and_then(Value::as_array);
    let temperature = |index: usize| Some(temperatures?.get(index)?.as_f64()? as f32);
    let status = object.has("status").then(|| object.byte("status")).transpose()?;
    let temperatures = [temperature(0), temperature(1)];
    Ok(State { id, position, velocity, torque, codes, temperatures, status })
}

/// Returns the largest fault number of a reply; 0 for motors that are never asked.
fn largest_fault(profile: &Profile) -> i64 {
    match profile.faults {
        FaultReport::Asked(reply) => (1 << (8 * reply.bytes)) - 1,
        FaultReport::InEveryReply(_) | FaultReport::Never => 0,
    }
}
