//! Compares the codec with frames derived from the vendor documents, in both directions.
//!
//! The vectors were derived without this crate. Their torques are for 0.1 N·m/A and a gear ratio of
//! 8.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_protocol::gim::{self, ConfigurationKey, Pending};
use motord_protocol::mit::{self, Asked, CommandCodes, ControlCodes, Impedance};
use motord_protocol::profile::STEADYWIN;
use motord_protocol::{Scales, StateCodes};
use serde_json::{Map, Value, json};

struct Vector {
    name: String,
    bytes: Vec<u8>,
    /// Bytes that this encoder sends where the bytes of the vector are forbidden.
    encoded_as: Vec<u8>,
    decoded: Value,
}

fn vectors(protocol: &str, direction: &str) -> Vec<Vector> {
    let all: Vec<Value> = serde_json::from_str(include_str!("golden_vectors.json")).unwrap();
    let wanted = |vector: &&Value| vector["protocol"] == protocol && vector["direction"] == direction;
    let found: Vec<_> = all.iter().filter(wanted).map(vector).collect();
    assert!(!found.is_empty(), "no vectors for {protocol} {direction}");
    found
}

fn vector(raw: &Value) -> Vector {
    let bytes = hex(raw["hex"].as_str().unwrap());
    Vector {
        name: raw["name"].as_str().unwrap().into(),
        encoded_as: raw["encoded_as"].as_str().map_or_else(|| bytes.clone(), hex),
        bytes,
        decoded: raw["decoded"].clone(),
    }
}

fn hex(digits: &str) -> Vec<u8> {
    let pairs = digits.as_bytes().chunks(2);
    pairs.map(|pair| u8::from_str_radix(core::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

fn scales() -> Scales {
    Scales::by_current(0.1, 8.0).unwrap()
}

/// Every key that the codec returns must be in the vector with this value. Further keys of the
/// vector are commentary.
fn assert_agrees(vector: &Vector, decoded: &Value) {
    let expected: Map<_, _> = vector.decoded.as_object().unwrap().clone();
    for (key, value) in decoded.as_object().unwrap() {
        let expected = &expected[key];
        let same = match (value.as_f64(), expected.as_f64()) {
            (Some(decoded), Some(expected)) => (decoded - expected).abs() < 1e-12,
            _ => value == expected,
        };
        assert!(same, "{}: {key} is {value}, expected {expected}", vector.name);
    }
}

fn json_of_mit_command(command: CommandCodes) -> Value {
    match command {
        CommandCodes::GetFault { f_cmd } => json!({ "kind": "get_fault", "f_cmd": f_cmd }),
        CommandCodes::ClearFault => json!({ "kind": "clear_fault" }),
        CommandCodes::Start => json!({ "kind": "start_motor" }),
        CommandCodes::Stop => json!({ "kind": "stop_motor" }),
        CommandCodes::SetZero => json!({ "kind": "set_zero" }),
        CommandCodes::Control(ControlCodes { position, velocity, kp, kd, torque }) => json!({
            "kind": "dynamic_control",
            "pos_int": position, "pos_rad": scales().position.decode(position),
            "vel_int": velocity, "vel_rad_s": scales().velocity.decode(velocity),
            "kp_int": kp, "kp": scales().kp.decode(kp),
            "kd_int": kd, "kd": scales().kd.decode(kd),
            "torque_int": torque, "torque_nm": scales().torque.decode(torque),
        }),
    }
}

#[test]
fn mit_commands_round_trip_as_documented() {
    for vector in vectors("mit", "to_motor") {
        let command = CommandCodes::decode(&vector.bytes).unwrap();
        assert_agrees(&vector, &json_of_mit_command(command));
        assert_eq!(command.encode()[..], vector.encoded_as, "{}", vector.name);
    }
}

#[test]
fn physical_requests_take_the_nearest_codes() {
    let mut held = 0;
    for vector in vectors("mit", "to_motor") {
        let request = &vector.decoded["request"];
        // A truncating driver sends other codes for the same request.
        if request.is_null() || vector.name.ends_with("_trunc") {
            continue;
        }
        let value = |key: &str| request[key].as_f64().unwrap() as f32;
        let impedance = Impedance {
            position: value("pos_rad"),
            velocity: value("vel_rad_s"),
            kp: value("kp"),
            kd: value("kd"),
            torque: value("torque_nm"),
        };
        let bytes = mit::Command::Control(impedance).encode(&scales()).unwrap();
        assert_eq!(bytes[..], vector.encoded_as, "{}", vector.name);
        held += 1;
    }
    assert!(held > 10);
}

fn json_of_mit_reply(reply: mit::Reply) -> Value {
    match reply {
        mit::Reply::State(state) => {
            let StateCodes { position, velocity, torque } = state.codes;
            json!({
                "kind": "state", "can_id": state.id,
                "pos_int": position, "pos_rad": scales().position.decode(position),
                "vel_int": velocity, "vel_rad_s": scales().velocity.decode(velocity),
                "torque_int": torque, "torque_nm": scales().torque.decode(torque),
            })
        }
        mit::Reply::Fault { id, number, .. } => {
            json!({ "kind": "fault_reply", "can_id": id, "fault": number })
        }
        mit::Reply::Cleared { id } => json!({ "kind": "clear_fault_reply", "can_id": id }),
    }
}

#[test]
fn mit_replies_round_trip_as_requested() {
    for vector in vectors("mit", "to_host") {
        let asked = match vector.decoded["kind"].as_str().unwrap() {
            "fault_reply" => Asked::Fault,
            "clear_fault_reply" => Asked::Clear,
            _ => Asked::State,
        };
        let reply = STEADYWIN.decode(&vector.bytes, asked, &scales()).unwrap();
        assert_agrees(&vector, &json_of_mit_reply(reply));
        let (written, known) = STEADYWIN.encode_over(&reply, [0; 8]);
        assert_eq!(written[..known], vector.bytes[..6], "{}", vector.name);
    }
}

/// Returns the name of a command in the vectors: that of the table, in snake case.
fn kind(code: gim::CommandCode) -> String {
    let mut name = String::new();
    for letter in format!("{code:?}").chars() {
        if letter.is_uppercase() && !name.is_empty() {
            name.push('_');
        }
        name.extend(letter.to_lowercase());
    }
    name
}

fn json_of_gim_command(command: gim::Command) -> Value {
    use gim::Command;
    let mut decoded = match command {
        Command::ModifyConfiguration { conf_id, value } => {
            json!({ "conf_type": value.value_type() as u8, "conf_id": conf_id, "value": value.as_f64() })
        }
        Command::RetrieveConfiguration(ConfigurationKey { conf_type, conf_id }) => {
            json!({ "conf_type": conf_type, "conf_id": conf_id })
        }
        Command::TorqueControl { torque, duration } => {
            json!({ "torque_nm": torque.get(), "duration_ms": duration.as_millis() })
        }
        Command::SpeedControl { speed_rpm, duration } => {
            json!({ "speed_rpm": speed_rpm.get(), "duration_ms": duration.as_millis() })
        }
        Command::PositionControl { position, duration } => {
            json!({ "position_rad": position.get(), "duration_ms": duration.as_millis() })
        }
        Command::ModifyParameter { para_id, value } => json!({ "para_id": para_id, "value": value }),
        Command::RetrieveParameter { para_id } => json!({ "para_id": para_id }),
        Command::RetrieveIndicator { ind_id } => json!({ "ind_id": ind_id }),
        Command::Calibration(gim::Calibration(cali_type)) if cali_type <= 1 => {
            json!({ "cali_type": cali_type })
        }
        _ => json!({}),
    };
    decoded["kind"] = kind(command.code()).into();
    decoded["cmd"] = (command.code() as u8).into();
    decoded
}

#[test]
fn gim_commands_round_trip_as_documented() {
    for vector in vectors("gim-can", "to_motor") {
        let command = gim::decode_command(&vector.bytes).unwrap();
        assert_agrees(&vector, &json_of_gim_command(command));
        let filler = vector.bytes[..].try_into().unwrap();
        assert_eq!(command.encode_over(filler)[..], vector.bytes, "{}", vector.name);
        let padded = if vector.name.ends_with("_mit_safe") {
            command.encode_mit_safe()
        } else {
            Some(command.encode())
        };
        if !vector.name.starts_with("hazard") {
            assert_eq!(padded.unwrap()[..], vector.bytes, "{}", vector.name);
        }
    }
}

fn json_of_gim_reply(reply: gim::Reply) -> Value {
    use gim::Reply;
    let mut decoded = match reply {
        Reply::State { outcome: Ok(state), .. } => {
            let StateCodes { position, velocity, torque } = state.codes;
            json!({
                "temperature_c": state.temperature_celsius,
                "pos_int": position, "pos_rad": scales().position.decode(position),
                "vel_int": velocity, "vel_rad_s": scales().velocity.decode(velocity),
                "torque_int": torque, "torque_nm": scales().torque.decode(torque),
            })
        }
        Reply::ConfigurationModified { key, .. } => {
            json!({ "conf_type": key.conf_type, "conf_id": key.conf_id })
        }
        Reply::Configuration { key, outcome: Ok(value) } => {
            json!({ "conf_type": key.conf_type, "conf_id": key.conf_id, "value": value.as_f64() })
        }
        Reply::Parameter { para_id, outcome: Ok(value) } => json!({ "para_id": para_id, "value": value }),
        Reply::Version(Ok(version)) => json!({ "version": version }),
        Reply::Fault(Ok(fault)) => json!({ "fault": fault.0 }),
        Reply::Indicator { ind_id, outcome: Ok(value) } => json!({ "ind_id": ind_id, "value": value.get() }),
        _ => json!({}),
    };
    let code = gim::CommandCode::from_byte(reply.code()).unwrap();
    decoded["kind"] = kind(code).into();
    decoded["cmd"] = reply.code().into();
    decoded["res"] = reply.res().into();
    decoded
}

#[test]
fn gim_replies_round_trip_as_documented() {
    for vector in vectors("gim-can", "to_host") {
        let reply = gim::decode_reply(&vector.bytes, Pending::Other, &scales()).unwrap();
        assert_agrees(&vector, &json_of_gim_reply(reply));
        assert_eq!(reply.encode_over([0; 8])[..], vector.bytes, "{}", vector.name);
    }
}

/// The tests of `motord-bus` compare the header with the vectors.
#[test]
fn serial_payloads_are_read_as_documented() {
    const HEADER: usize = 4;
    for direction in ["to_motor", "to_host"] {
        let normal = |vector: &Vector| vector.decoded["kind"] != "ack_error";
        for vector in vectors("gim-rs485", direction).into_iter().filter(normal) {
            let payload = &vector.bytes[HEADER..];
            let mut decoded = match direction {
                "to_motor" => json_of_gim_command(gim::decode_command(payload).unwrap()),
                _ => json_of_gim_reply(gim::decode_reply(payload, Pending::Other, &scales()).unwrap()),
            };
            assert_eq!(decoded["kind"].take(), vector.decoded["kind"], "{}", vector.name);
        }
    }
}
