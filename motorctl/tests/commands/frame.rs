//! `motorctl frame`, as called by a user, against frames derived from the vendor documents.

use crate::schemas::assert_lines_valid;
use serde_json::{Value, json};
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};

struct Vector {
    name: String,
    protocol: String,
    direction: String,
    hex: String,
    /// The bytes that an encoder must send instead, where these bytes are forbidden.
    encoded_as: String,
    decoded: Value,
}

fn vectors() -> Vec<Vector> {
    let text = include_str!("../../../motors/protocol/tests/golden_vectors.json");
    let vectors: Vec<Value> = serde_json::from_str(text).unwrap();
    let text = |vector: &Value, key: &str| vector[key].as_str().map(str::to_owned);
    vectors
        .iter()
        .map(|vector| Vector {
            name: text(vector, "name").unwrap(),
            protocol: text(vector, "protocol").unwrap(),
            direction: text(vector, "direction").unwrap().replace('_', "-"),
            hex: text(vector, "hex").unwrap(),
            encoded_as: text(vector, "encoded_as").or_else(|| text(vector, "hex")).unwrap(),
            decoded: vector["decoded"].clone(),
        })
        .collect()
}

impl Vector {
    fn layout(&self) -> [&str; 8] {
        let (protocol, direction) = (self.protocol.as_str(), self.direction.as_str());
        ["--protocol", protocol, "--direction", direction, "--torque-constant", "0.1", "--gear-ratio", "8"]
    }

    fn decode(&self) -> Value {
        let asked = match self.decoded["kind"].as_str().unwrap() {
            "fault_reply" => "get_fault",
            "clear_fault_reply" => "clear_fault",
            _ => "state",
        };
        let output = frame("decode", &[&self.layout()[..], &["--asked", asked, &self.hex]].concat(), "");
        assert!(output.status.success(), "{}: {output:?}", self.name);
        serde_json::from_slice(&output.stdout).unwrap()
    }

    fn encode(&self, object: &Value) -> String {
        let output = frame("encode", &[&self.layout()[..], &[&object.to_string()]].concat(), "");
        assert!(output.status.success(), "{}: {output:?}", self.name);
        text(&output).trim().into()
    }
}

pub(crate) fn frame(verb: &str, arguments: &[&str], input: &str) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_motorctl"))
        .args(["frame", verb])
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
    child.wait_with_output().unwrap()
}

pub(crate) fn text(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub(crate) fn objects(output: &Output) -> Vec<Value> {
    text(output).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn is_same(decoded: &Value, expected: &Value) -> bool {
    match (decoded.as_f64(), expected.as_f64()) {
        (Some(decoded), Some(expected)) => (decoded - expected).abs() <= 1e-12 * expected.abs().max(1.0),
        _ => decoded == expected,
    }
}

/// Returns `true` for keys of the vectors that explain a frame and that `decode` does not print.
fn is_commentary(key: &str) -> bool {
    ["as_state", "as_mit", "meaning", "request", "would_be_control", "value_by_literal_EN_formula"]
        .contains(&key)
}

#[test]
fn decode_tells_every_key_of_every_golden_vector() {
    for vector in vectors() {
        let decoded = vector.decode();
        assert_lines_valid("motorctl-frame-decode", &decoded.to_string());
        for (key, expected) in vector.decoded.as_object().unwrap() {
            let agrees = is_commentary(key) || is_same(&decoded[key], expected);
            assert!(agrees, "{}: {key} is {}, expected {expected}", vector.name, decoded[key]);
        }
    }
}

#[test]
fn encode_reproduces_vectors_from_decode_output() {
    for vector in vectors().iter().filter(|vector| !vector.name.contains("ALIAS")) {
        assert_eq!(vector.encode(&vector.decode()), vector.encoded_as, "{}", vector.name);
    }
}

#[test]
fn encode_reproduces_vectors_from_their_keys() {
    // A truncating driver's choice of codes, a danger to avoid, and a reply that is longer than the
    // document's.
    let is_ours =
        |name: &str| !["_trunc", "ALIAS", "hazard", "dlc8"].iter().any(|variant| name.contains(variant));
    for vector in vectors().iter().filter(|vector| is_ours(&vector.name)) {
        let mut object = vector.decoded.clone();
        object.as_object_mut().unwrap().retain(|key, _| key == "as_mit" || !is_commentary(key));
        assert_eq!(vector.encode(&object), vector.encoded_as, "{}", vector.name);
    }
}

/// Goal: no frame is sent that differs from its description.
/// Method: the test adds a member that is not in the frame to every golden vector. It also changes
/// each member that follows from others.
#[test]
fn encode_refuses_unknown_and_contradicting_members() {
    let derived = ["name", "unit", "faults", "cmd"];
    for vector in vectors().iter().filter(|vector| !vector.name.contains("ALIAS")) {
        let whole = vector.decode();
        let changed = |key: &'static str, value: Value| {
            let mut object = whole.clone();
            object[key] = value;
            (key, object.to_string())
        };
        let is_there = |key: &&'static str| whole.get(*key).is_some() && whole["kind"] != "unknown";
        let other = |key| whole[key].as_u64().map_or(json!("00"), |cmd| json!(cmd ^ 1));
        let added = [changed("kn", json!(1)), changed("speed", json!("fast"))];
        let derived = derived.into_iter().filter(is_there).map(|key| changed(key, other(key)));
        let (keys, objects): (Vec<_>, Vec<_>) = added.into_iter().chain(derived).unzip();
        let arguments = objects.iter().map(String::as_str);
        let output = frame("encode", &vector.layout().into_iter().chain(arguments).collect::<Vec<_>>(), "");
        let answers = text(&output);
        assert_eq!((answers.lines().count(), output.status.code()), (keys.len(), Some(65)), "{output:?}");
        for (key, answer) in keys.iter().zip(answers.lines()) {
            let is_refused = answer.contains(r#""kind":"reject""#);
            let is_named = answer.contains(&format!("'{key}'")) || *key == "cmd";
            assert!(is_refused && is_named, "{}: {key} in {objects:?}: {answer}", vector.name);
        }
    }
}

/// Random bytes, the same in every run (SplitMix64).
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> [u8; 8] {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        ((mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB)).to_le_bytes()
    }

    /// Returns a native payload: most have command, result and ids of the document.
    fn native(&mut self) -> [u8; 8] {
        let [choice, command, sub, id, ..] = self.next();
        let mut bytes = self.next();
        if choice & 1 != 0 {
            const COMMANDS: &[u8] =
                b"\x81\x82\x83\x84\x91\x92\x93\x94\x95\x96\x97\xA1\xA2\xB1\xB2\xB3\xB4\xB5\xC1";
            bytes[0] = COMMANDS[usize::from(command) % COMMANDS.len()];
        }
        if choice & 2 != 0 {
            bytes[1] = sub % 3;
        }
        if choice & 4 != 0 {
            (bytes[2], bytes[3]) = (id % 0x21, 0);
        }
        bytes
    }

    /// GIM document, table 3.
    fn serial(&mut self) -> Vec<u8> {
        let ([id, choice, len, ..], payload) = (self.next(), self.native());
        let (kind, len) = if choice < 16 { (1, len % 9) } else { (0, 8) };
        [&[id, kind, len, id ^ kind ^ len], &payload[..len.into()]].concat()
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect()
}

/// Generates frames: encoding the output of `decode` must reproduce them, byte for byte.
fn is_identity(layout: &[&str], asked: &str, make: impl Fn(&mut Noise) -> Vec<u8>) {
    let mut noise = Noise(asked.len() as u64);
    let frames: Vec<String> = (0..3_000).map(|_| hex(&make(&mut noise))).collect();
    let decode = [layout, &["--asked", asked, "-"]].concat();
    let decoded = text(&frame("decode", &decode, &frames.join("\n")));
    assert_eq!(decoded.lines().count(), frames.len());
    assert_lines_valid("motorctl-frame-decode", &decoded);
    let read = frames.iter().zip(decoded.lines()).filter(|(_, object)| !object.contains("\"reject\""));
    let (frames, objects): (Vec<&String>, Vec<&str>) = read.unzip();
    assert!(frames.len() > 2_500, "{layout:?}: {} of 3000 frames were read", frames.len());
    let encoded = text(&frame("encode", &[layout, &["-"]].concat(), &objects.join("\n")));
    for ((frame, object), again) in frames.iter().zip(objects).zip(encoded.lines()) {
        assert_eq!(**frame, again, "{layout:?}: {object}");
    }
    assert_eq!(encoded.lines().count(), frames.len());
}

#[test]
fn decoded_frames_encode_to_themselves() {
    const CONSTANTS: [&str; 4] = ["--torque-constant", "0.067", "--gear-ratio", "36"];
    for (direction, asked) in [("to-motor", "state"), ("to-host", "state"), ("to-host", "calibration")] {
        for constants in [&CONSTANTS[..], &[]] {
            let layout = |protocol| [&["--protocol", protocol, "--direction", direction], constants].concat();
            is_identity(&layout("gim-can"), asked, |noise| noise.native().to_vec());
            is_identity(&layout("gim-rs485"), asked, Noise::serial);
        }
    }
    for (profile, length) in [("steadywin", 6), ("GIM4310-36", 6), ("DM-J4310-2EC", 8), ("RS00", 8)] {
        let layout = |direction| ["--protocol", "mit", "--direction", direction, "--profile", profile];
        is_identity(&layout("to-motor"), "state", |noise| noise.next().to_vec());
        is_identity(&layout("to-host"), "state", |noise| noise.next()[..length].to_vec());
    }
}

#[test]
fn duplicate_and_absent_keys_are_refused() {
    let native = "gim-can";
    let cases = [
        (native, r#"{"kind":"start_motor","kind":"stop_motor"}"#, "'kind' occurs twice"),
        (native, r#"{"kind":"start_motor","as_mit":{"kp":1,"kp":2}}"#, "'kp' occurs twice"),
        (native, r#"{"kind":"start_motor","pos_int":5}"#, "'pos_int' is not in this frame"),
        ("mit", r#"{"kind":"stop_motor","pos_int":5,"kp":500}"#, "is not in this frame"),
        (
            native,
            r#"{"kind":"torque_control","torque_nm":1,"duration_ms":0,"pos_int":4,"kp":3}"#,
            "is not in this frame",
        ),
        (
            native,
            r#"{"kind":"retrieve_configuration","conf_type":0,"conf_id":20,"position_rad":1}"#,
            "'position_rad' is not in",
        ),
        (
            native,
            r#"{"kind":"start_motor","as_mit":{"kind":"stop_motor"}}"#,
            "'kind' is \\\"stop_motor\\\", but the frame has",
        ),
        (
            native,
            r#"{"kind":"start_motor","as_mit":{"kind":"dynamic_control","pos_int":0,"vel_int":0,"kp_int":0,"kd_int":0,"torque_int":0}}"#,
            "'as_mit' is",
        ),
        (
            native,
            r#"{"kind":"start_motor","as_mit":{"kind":"dynamic_control","pos_int":37120,"vel_int":0,"kp_int":0,"kd_int":0,"torque_int":0,"bogus":1}}"#,
            "'bogus' is not in this frame",
        ),
        ("mit", r#"{"kind":"stop_motor","as_mit":{"kind":"stop_motor"}}"#, "'as_mit' is not in this frame"),
    ];
    for (protocol, object, reason) in cases {
        let output = frame("encode", &["--protocol", protocol, "--direction", "to-motor", object], "");
        assert_eq!(output.status.code(), Some(65), "{object}");
        assert!(text(&output).contains(reason), "{object}: {}", text(&output));
    }
}

#[test]
fn physical_values_and_raw_codes_encode_alike() {
    let physical = ["pos_rad", "vel_rad_s", "kp", "kd", "torque_nm"];
    let raw = ["pos_int", "vel_int", "kp_int", "kd_int", "torque_int"];
    for vector in vectors().iter().filter(|vector| vector.decoded.get("torque_int").is_some()) {
        let whole = vector.decode();
        let without = |keys: [&str; 5]| {
            let mut object = whole.clone();
            object.as_object_mut().unwrap().retain(|key, _| !keys.contains(&key.as_str()));
            vector.encode(&object)
        };
        assert_eq!([without(raw), without(physical)], [vector.encoded_as.as_str(); 2], "{}", vector.name);
    }
}

const MIT: [&str; 4] = ["--protocol", "mit", "--direction", "to-motor"];

#[test]
fn frames_are_read_as_people_write_them() {
    let spellings =
        ["FFFFFFFFFFFFFFFC", "ff ff ff ff ff ff ff fc", "001#FFFFFFFFFFFFFFFC", "1#FF.FF.FF.FF.FF.FF.FF.FC"];
    let output = frame(
        "decode",
        &[&MIT[..], &spellings, &["-"]].concat(),
        "FFFFFFFFFFFFFFFC\n\n 001#FFFFFFFFFFFFFFFC\r\n",
    );
    assert_eq!(objects(&output), vec![json!({ "kind": "start_motor" }); 6]);
}

#[test]
fn refused_frame_shows_reason_and_exit_status() {
    let output = frame("decode", &[&MIT[..], &["FFFFFFFFFFFFFFFC", "FF", "", "zz", "123"]].concat(), "");
    let objects = objects(&output);
    let kinds: Vec<_> = objects.iter().map(|object| object["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["start_motor", "reject", "reject", "reject", "reject"]);
    assert!(objects[1]["reason"].as_str().unwrap().contains("1 bytes, expected 8"));
    assert_eq!(output.status.code(), Some(65));
}

#[test]
fn object_without_frame_is_refused_with_reason() {
    for (object, reason) in [
        (json!({ "kind": "dynamic_control" }), "'pos_int' is missing"),
        (json!({ "kind": "no_such_thing" }), "no_such_thing"),
        (json!({}), "'kind' is missing"),
        (json!([1]), "not a JSON object"),
        (json!({ "kind": "get_fault", "f_cmd": 255 }), "expected 0 to 254"),
        (json!({ "kind": "get_fault", "f_cmd": 1.5 }), "expected 0 to 254"),
        (
            json!({ "kind": "dynamic_control", "pos_int": 0, "pos_rad": 1.0, "vel_int": 0, "kp_int": 0, "kd_int": 0, "torque_int": 0 }),
            "nearest to 'pos_rad' is 35389",
        ),
        (
            json!({ "kind": "dynamic_control", "pos_rad": 1.0, "vel_int": 0, "kp_int": 0, "kd_int": 0, "torque_nm": 0 }),
            "needs the torque constant",
        ),
    ] {
        let output = frame("encode", &[&MIT[..], &[&object.to_string()]].concat(), "");
        assert_eq!(output.status.code(), Some(65), "{object}");
        assert!(objects(&output)[0]["reason"].as_str().unwrap().contains(reason), "{object}: {output:?}");
    }
}

#[test]
fn control_frame_never_becomes_special_or_zeros() {
    let control = |value: f64| {
        json!({ "kind": "dynamic_control", "pos_rad": value, "vel_rad_s": value, "kp": value, "kd": value,
            "torque_nm": value, "torque_constant": 0.1, "gear_ratio": 8 })
    };
    let input = format!("{}\n{}", control(1e9), control(-1e9));
    let output = frame("encode", &MIT, &input);
    assert_eq!(text(&output), "FFFFFFFFFEFFFFFF\n0001000000000000\n");
}

#[test]
fn gim_commands_are_padded_for_mit_mode() {
    let gim = ["--protocol", "gim-can", "--direction", "to-motor", "--mit-safe"];
    let output = frame("encode", &gim, r#"{"kind":"stop_motor"} {"kind":"get_fault"}"#);
    assert_eq!(text(&output), "9200800000000800\nB200800000000800\n");
    let unsafe_one = r#"{"kind":"modify_parameter","para_id":1,"value":2}"#;
    assert_eq!(frame("encode", &gim, unsafe_one).status.code(), Some(65));
}

#[test]
fn undocumented_frame_is_reported_and_reencoded() {
    for (direction, hex, kind) in [
        ("to-motor", "1100000000000000", "unknown"),
        ("to-motor", "FF01020304050607", "unknown"),
        ("to-host", "FF02000000000000", "unknown"),
        ("to-host", "B50100FF00000000", "calibration"),
        ("to-host", "84000205DEADBEEF", "retrieve_configuration"),
    ] {
        let layout = ["--protocol", "gim-can", "--direction", direction];
        let decoded = text(&frame("decode", &[&layout[..], &[hex]].concat(), ""));
        assert_eq!(serde_json::from_str::<Value>(&decoded).unwrap()["kind"], kind);
        assert_eq!(text(&frame("encode", &layout, &decoded)).trim(), hex);
    }
}

#[test]
fn serial_frame_with_contradicting_payload_is_refused() {
    let layout = ["--protocol", "gim-rs485", "--direction", "to-motor"];
    let object = json!({ "kind": "start_motor", "header": { "id": 1 }, "payload": "9200000000000000" });
    let output = frame("encode", &[&layout[..], &[&object.to_string()]].concat(), "");
    assert_eq!(output.status.code(), Some(65));
    assert!(text(&output).contains("'kind' is"), "{output:?}");
    let reply = json!({ "kind": "torque_control", "header": { "id": 0 }, "payload": "9300190080008008", "pos_int": 1 });
    let layout = ["--protocol", "gim-rs485", "--direction", "to-host"];
    let output = frame("encode", &[&layout[..], &[&reply.to_string()]].concat(), "");
    assert!(text(&output).contains("'pos_int' is 1"), "{output:?}");
}

pub(crate) const ROBOT: &str = r#"
[[bus]]
name = "front-left"
type = "socketcan"
interface = "vcan0"
[[motor]]
name = "fl-hip"
bus = "front-left"
id = 1
protocol = "mit"
model = "GIM8108-8"
direction = -1
[[motor]]
name = "fl-knee"
bus = "front-left"
id = 0x05
host-id = 0x300
protocol = "gim"
model = "GIM8108-8"
torque-constant-nm-per-a = 0.1
gear-ratio = 8
"#;

fn decode_log(options: &[&str], config: &str, log: &str) -> Output {
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(config.as_bytes()).unwrap();
    frame("decode", &[options, &["--config", file.path().to_str().unwrap(), "-"]].concat(), log)
}

/// One file has one meaning for the daemon and for the decoder of its logs.
#[test]
fn configuration_the_daemon_refuses_is_refused() {
    let refused = ROBOT.replace("gear-ratio = 8", "gear-ratio = -8");
    let output = decode_log(&[], &refused, "(0.1) vcan0 001#FFFFFFFFFFFFFFFC\n");
    let complaint = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(78), "{complaint}");
    assert!(complaint.contains("motor.gear-ratio"), "{complaint}");
}

/// A motor with registers, whose answer begins like a state.
#[test]
fn registers_of_damiao_are_no_states() {
    let config = "\
        [[bus]]\nname = 'front'\ntype = 'socketcan'\ninterface = 'vcan0'\n\
        [[motor]]\nname = 'hip'\nbus = 'front'\nid = 1\nprotocol = 'mit'\nmodel = 'DM-J8009-2EC'\n";
    let log = "(0.1) vcan0 7FF#0100331500000000\n\
        (0.2) vcan0 011#0100331500004841\n\
        (0.3) vcan0 011#0100331500004841\n\
        (0.4) vcan0 7FF#0200331500000000\n";
    let output = decode_log(&[], config, log);
    let decoded: Vec<_> = objects(&output)
        .iter()
        .map(|object| ["kind", "motor", "register", "value"].map(|key| object[key].clone()))
        .collect();
    let register = |kind: &str, value| [json!(kind), json!("hip"), json!(21), value];
    assert_eq!(decoded[0], register("register_read", Value::Null));
    assert_eq!(decoded[1], register("register_value", json!(12.5)));
    assert_eq!(decoded[2][0], "state", "only the first answer to a request is its answer");
    assert_eq!(decoded[3][0], "reject", "no motor has this id");
    for line in text(&output).lines() {
        assert_lines_valid("motorctl-frame-decode", line);
    }
}

#[test]
fn frames_of_imus_are_decoded_with_names() {
    let config = "\
        [cycle]\nrate-hz = 400\n\
        [[bus]]\nname = 'front'\ntype = 'socketcan'\ninterface = 'vcan0'\n\
        [[motor]]\nname = 'hip'\nbus = 'front'\nid = 2\nprotocol = 'mit'\nmodel = 'GIM8108-8'\n\
        [[imu]]\nname = 'base'\ntype = 'damiao'\nbus = 'front'\n\
        [[imu]]\nname = 'head'\ntype = 'hipnuc-can'\nbus = 'front'\n";
    let log = "(0.1) vcan0 001#CC0200DD00000000\n\
        (0.2) vcan0 011#04FFFE0008002000\n\
        (0.3) vcan0 188#00000000E803\n\
        (0.4) vcan0 708#05\n\
        (0.5) vcan0 488#0000000000000000\n\
        (0.6) vcan0 001#CC0B01DD01000000\n";
    let output = decode_log(&[], config, log);
    let decoded: Vec<_> = objects(&output)
        .iter()
        .map(|object| ["kind", "imu", "quantity", "values"].map(|key| object[key].clone()))
        .collect();
    assert_eq!(decoded[0], [json!("imu_request"), json!("base"), json!("angular velocity"), Value::Null]);
    assert_eq!(decoded[1][..3], [json!("imu_sample"), json!("base"), json!("orientation")]);
    assert_eq!(decoded[2][..3], [json!("imu_sample"), json!("head"), json!("acceleration")]);
    assert!((decoded[2][3][2].as_f64().unwrap() - 9.8).abs() < 1e-5, "{:?}", decoded[2]);
    assert_eq!(decoded[3], [json!("imu_state"), json!("head"), Value::Null, Value::Null]);
    assert_eq!([&decoded[4][0], &decoded[5][0]], ["reject", "reject"], "no rotation, a write of a setting");
    for line in text(&output).lines() {
        assert_lines_valid("motorctl-frame-decode", line);
    }
}

#[test]
fn log_is_decoded_with_motor_names_and_requests() {
    let log = "\
        (1436509052.249713) vcan0 001#FFFFFFFFFFFF00FB\n\
        (1436509052.250000) vcan0 101#010200000000\n\
        (1436509052.251000) vcan0 001#FFFFFFFFFFFFFFFD\n\
        (1436509052.252000) vcan0 101#010200000000\n\
        (1436509052.253000) vcan0 005#B501000000000000\n\
        (1436509052.254000) vcan0 300#B401000000000000\n";
    let output = decode_log(&[], ROBOT, log);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let decoded: Vec<_> = objects(&output)
        .iter()
        .map(|object| format!("{} {}", object["motor"].as_str().unwrap(), object["kind"].as_str().unwrap()))
        .collect();
    let expected = [
        "fl-hip get_fault",
        "fl-hip fault_reply",
        "fl-hip stop_motor",
        "fl-hip state",
        "fl-knee calibration",
        "fl-knee calibration",
    ];
    assert_eq!(decoded, expected);
    let first = &objects(&output)[0];
    assert_eq!((&first["time"], &first["interface"]), (&json!(1436509052.249713), &json!("vcan0")));
    let state = &objects(&output)[3];
    assert_eq!(
        (&state["torque_constant"], &state["gear_ratio"]),
        (&json!(0.125), &json!(8.0)),
        "of the model"
    );
}

#[test]
fn old_log_is_decoded_with_earlier_protocol() {
    let log = "(0.1) vcan0 001#B200000000000000\n(0.2) vcan0 101#B200000000000000\n";
    let output = decode_log(&["--protocol", "gim-can"], ROBOT, log);
    let kinds: Vec<_> = objects(&output).iter().map(|object| object["kind"].clone()).collect();
    assert_eq!(kinds, ["get_fault", "get_fault"], "{output:?}");
    assert!(objects(&output).iter().all(|object| object["motor"] == "fl-hip"));
}

#[test]
fn impossible_frame_is_refused_and_log_continues() {
    let log = "\
        (0.1) vcan0 20000040#0000000000000000\n\
        (0.2) vcan0 007#00\n\
        (0.3) vcan1 001#FFFFFFFFFFFFFFFC\n\
        (0.4) vcan0 101#020200000000\n\
        not a log\n\
        (0.5) vcan0 001#FFFFFFFFFFFFFFFC\n";
    let output = decode_log(&[], ROBOT, log);
    let kinds: Vec<_> = objects(&output).iter().map(|object| object["kind"].clone()).collect();
    assert_eq!(kinds[..5], vec![json!("reject"); 5]);
    assert_eq!(kinds[5], "start_motor");
    assert_eq!(output.status.code(), Some(65));
}

#[test]
fn misuse_and_bad_configuration_have_exit_statuses() {
    let status = |arguments: &[&str]| frame("decode", arguments, "").status.code();
    assert_eq!(status(&["FF"]), Some(64), "no protocol");
    assert_eq!(status(&["--protocol", "can-open", "--direction", "to-motor", "FF"]), Some(64));
    assert_eq!(status(&MIT), Some(64), "no frame");
    assert_eq!(status(&[&MIT[..], &["--verbose", "FF"]].concat()), Some(64));
    assert_eq!(status(&["--config", "motord.toml", "--direction", "to-host", "-"]), Some(64), "the id tells");
    assert_eq!(status(&["--protocol", "mit", "FF"]), Some(64), "no direction");
    assert_eq!(status(&[&MIT[..], &["--torque-constant", "0.1", "FF"]].concat()), Some(64), "half a scale");
    assert_eq!(
        status(&[&MIT[..], &["--torque-constant", "0", "--gear-ratio", "8", "FF"]].concat()),
        Some(64)
    );
    assert_eq!(status(&["--config", "/nonexistent", "-"]), Some(78));
    assert_eq!(decode_log(&[], "[[motor]]", "").status.code(), Some(78));
    assert_eq!(status(&["--help"]), Some(0));
}

/// A FIFO without a writer, an endless device and a huge file are refused immediately, as by the
/// daemon.
#[test]
fn unreadable_configuration_is_refused_immediately() {
    let directory = tempfile::tempdir().unwrap();
    let (fifo, huge, open) =
        (directory.path().join("fifo"), directory.path().join("huge"), directory.path().join("open"));
    nix::unistd::mkfifo(&fifo, nix::sys::stat::Mode::S_IRWXU).unwrap();
    std::fs::File::create(&huge).unwrap().set_len(100_000_000).unwrap();
    std::fs::write(&open, "").unwrap();
    std::fs::set_permissions(&open, std::fs::Permissions::from_mode(0o666)).unwrap();
    for (path, reason) in [
        (fifo.as_path(), "is a FIFO"),
        (Path::new("/dev/zero"), "is a device"),
        (&huge, "is larger than"),
        (&open, "may be changed by every user"),
    ] {
        let output = frame("decode", &["--config", path.to_str().unwrap(), "-"], "");
        let complaint = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(78), "{complaint}");
        assert!(complaint.contains(reason), "{complaint}");
    }
}

#[test]
fn satisfied_reader_is_no_failure() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_motorctl"))
        .args(["frame", "decode"])
        .args(MIT)
        .arg("-")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    // The pipe to a tool that has ended breaks as well.
    let _ = child.stdin.take().unwrap().write_all(b"FFFFFFFFFFFFFFFC\nFFFFFFFFFFFFFFFC\n");
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), output.stderr), (Some(0), Vec::new()));
}
