//! Every configuration that must be refused, and why; and that those we ship are not.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::time::Duration;

use motord::commands::check::{EXIT_CONFIG, Wanted, check};
use motord_configuration::{ConfigError, Loaded, Machine, load, parse, reference};
use motord_core::settings::{BusKind, IpcMode, SafeStop};
use proptest::prelude::*;
use tempfile::TempDir;

/// A configuration with nothing wrong, for the tests to damage.
const GOOD: &str = "
[daemon]
instance = 'robot'
[cycle]
rate-hz = 1000
[exchange]
mode = 'timed'
[safety]
setpoint-timeout-ms = 20
[[bus]]
name = 'front'
type = 'simulated'
[[bus]]
name = 'gripper'
type = 'simulated'
[[motor]]
name = 'hip'
bus = 'front'
id = 1
protocol = 'mit'
model = 'GIM8108-8'
damping-kd = 2.0
[motor.limits]
position-rad = [-1.2, 1.2]
velocity-rad-s = 30.0
torque-nm = 20.0
kp-max = 200.0
kd-max = 5.0
[[motor]]
name = 'knee'
bus = 'front'
id = 2
protocol = 'mit'
model = 'GIM8108-8'
[[motor]]
name = 'jaw'
bus = 'gripper'
id = 1
protocol = 'gim'
model = 'GIM3505-8'
[[group]]
name = 'legs'
joints = ['hip', 'knee']
[[group]]
name = 'hand'
joints = ['jaw']
";

/// One way to damage [`GOOD`]: a line of it, what stands there instead, and the complaint that must follow. The line
/// complained about is the one that bears [`MARK`].
type Case = (&'static str, &'static str, &'static str, &'static str);
const MARK: &str = "#!";

const REFUSED: &[Case] = &[
    // The text.
    ("rate-hz = 1000", "rate-hz = = 1 #!", "", "extra `=`"),
    (
        "model = 'GIM3505-8'",
        "model = 'GIM3505-8'\ncontrol-duration-ms = 2 #!",
        "motor.control-duration-ms",
        "give it at least 3 ms",
    ),
    (
        "damping-kd = 2.0",
        "control-duration-ms = 20 #!",
        "motor.control-duration-ms",
        "an MIT command has no duration",
    ),
    ("[cycle]", "[cycle #!", "", "unclosed table"),
    (
        "kp-max = 200.0",
        "kp-mx = 200.0 #!",
        "motor.limits.kp-mx",
        "unknown key `kp-mx`; did you mean `kp-max`?",
    ),
    ("[safety]", "[saftey] #!", "saftey", "unknown key `saftey`; did you mean `safety`?"),
    ("rate-hz = 1000", "rate-hz = 1000\nrate-hz = 500 #!", "", "`rate-hz`: is there twice"),
    ("rate-hz = 1000", "rate-hz = 'fast' #!", "cycle.rate-hz", "expected a number"),
    ("rate-hz = 1000", "cpu = 1.5 #!", "cycle.cpu", "expected an integer"),
    ("mode = 'timed'", "mode = 3 #!", "exchange.mode", "expected a text, found an integer"),
    ("mode = 'timed'", "mode = 'fast' #!", "exchange.mode", "unknown value `fast`; known are timed, spin"),
    ("instance = 'robot'", "instance = 'My/Robot' #!", "daemon.instance", "cannot be a name"),
    ("instance = 'robot'", "instance = 'Robot' #!", "daemon.instance", "use only a-z, 0-9 and `-`"),
    // Missing keys.
    ("[[bus]]\nname = 'front'", "[[bus]] #!", "bus.name", "is missing"),
    (
        "[[bus]]\nname = 'gripper'\ntype = 'simulated'",
        "[[bus]] #!\nname = 'gripper'",
        "bus.type",
        "is missing",
    ),
    ("type = 'simulated'", "type = 'socketcan'", "bus.interface", "is missing"),
    ("[[motor]]\nname = 'knee'", "[[motor]] #!", "motor.name", "is missing"),
    ("[[motor]]\nname = 'knee'\nbus = 'front'", "[[motor]] #!\nname = 'knee'", "motor.bus", "is missing"),
    ("bus = 'front'\nid = 2", "bus = 'front'", "motor.id", "is missing"),
    ("id = 2\nprotocol = 'mit'", "id = 2", "motor.protocol", "is missing"),
    ("model = 'GIM3505-8'", "", "motor.model", "is missing; give the motor's model"),
    ("joints = ['jaw']", "", "group.joints", "is missing"),
    // Numbers.
    (
        "velocity-rad-s = 30.0",
        "velocity-rad-s = nan #!",
        "motor.limits.velocity-rad-s",
        "not a finite number",
    ),
    ("torque-nm = 20.0", "torque-nm = inf #!", "motor.limits.torque-nm", "not a finite number"),
    ("position-rad = [-1.2, 1.2]", "position-rad = [nan, 1] #!", "motor.limits.position-rad", "not a finite"),
    (
        "velocity-rad-s = 30.0",
        "velocity-rad-s = -30.0 #!",
        "motor.limits.velocity-rad-s",
        "-30 is out of range",
    ),
    ("torque-nm = 20.0", "torque-nm = -20.0 #!", "motor.limits.torque-nm", "-20 is out of range"),
    ("kp-max = 200.0", "kp-max = -1 #!", "motor.limits.kp-max", "-1 is out of range"),
    (
        "position-rad = [-1.2, 1.2]",
        "position-rad = [1.2, -1.2] #!",
        "motor.limits.position-rad",
        "is not below",
    ),
    (
        "position-rad = [-1.2, 1.2]",
        "position-rad = [1.2, 1.2] #!",
        "motor.limits.position-rad",
        "is not below",
    ),
    (
        "position-rad = [-1.2, 1.2]",
        "position-rad = [1.2] #!",
        "motor.limits.position-rad",
        "expected two numbers",
    ),
    ("position-rad = [-1.2, 1.2]", "position-rad = [1, 2, 3] #!", "motor.limits.position-rad", "found 3"),
    // The protocol's scale, and its end.
    ("position-rad = [-1.2, 1.2]", "position-rad = [-1, 13] #!", "motor.limits.position-rad", "beyond ±12.5"),
    ("velocity-rad-s = 30.0", "velocity-rad-s = 66 #!", "motor.limits.velocity-rad-s", "beyond ±65"),
    ("kp-max = 200.0", "kp-max = 501 #!", "motor.limits.kp-max", "beyond ±500"),
    ("kd-max = 5.0", "kd-max = 5.1 #!", "motor.limits.kd-max", "beyond ±5"),
    ("torque-nm = 20.0", "torque-nm = 226 #!", "motor.limits.torque-nm", "beyond ±225"),
    ("torque-nm = 20.0", "torque-nm = 23 #!", "motor.limits.torque-nm", "more than the motor's peak of 22"),
    (
        "damping-kd = 2.0",
        "rated-torque-nm = 23 #!",
        "motor.rated-torque-nm",
        "more than the motor's peak of 22",
    ),
    ("damping-kd = 2.0", "overload-seconds = 0 #!", "motor.overload-seconds", "0 is out of range"),
    ("rate-hz = 1000", "max-skipped-percent = 0 #!", "cycle.max-skipped-percent", "0 is out of range"),
    (
        "position-rad = [-1.2, 1.2]",
        "position-rad = [0, 12.5] #!",
        "motor.limits.position-rad",
        "special frame",
    ),
    (
        "damping-kd = 2.0\n[motor.limits]\nposition-rad = [-1.2, 1.2]",
        "offset-rad = 12.0\n[motor.limits]\nposition-rad = [0.5, 24.5] #!",
        "motor.limits.position-rad",
        "end of the protocol's scale",
    ),
    ("velocity-rad-s = 30.0", "velocity-rad-s = 65.0 #!", "motor.limits.velocity-rad-s", "special frame"),
    ("kp-max = 200.0", "kp-max = 500 #!", "motor.limits.kp-max", "use at most 497.5"),
    (
        "kp-max = 200.0",
        "temperature-derate-celsius = 95 #!",
        "motor.limits.temperature-derate-celsius",
        "derating begins",
    ),
    // Names, ids, models.
    ("name = 'knee'", "name = 'hip' #!", "motor.name", "\"hip\" is taken by an earlier motor"),
    ("name = 'gripper'", "name = 'front' #!", "bus.name", "\"front\" is taken by an earlier bus"),
    ("name = 'hand'", "name = 'legs' #!", "group.name", "\"legs\" is taken by an earlier group"),
    ("id = 2", "id = 1 #!", "motor.id", "id 1 is used by \"hip\" on the same bus"),
    ("id = 2", "id = 0 #!", "motor.id", "0 is out of range"),
    ("id = 2", "id = 255 #!", "motor.id", "255 is out of range"),
    ("id = 2", "id = 2\nhost-id = 2 #!", "motor.host-id", "is a motor's command id on the same bus"),
    ("id = 2", "id = 2\nhost-id = 0x101 #!", "motor.host-id", "is the reply id of \"hip\" too"),
    ("id = 2", "id = 2\nhost-id = 0x800 #!", "motor.host-id", "2048 is out of range"),
    ("protocol = 'gim'", "protocol = 'canopen' #!", "motor.protocol", "unknown value `canopen`"),
    (
        "model = 'GIM3505-8'",
        "model = 'GIM9999-8' #!",
        "motor.model",
        "unknown model \"GIM9999-8\"; did you mean `GIM8108-9`?",
    ),
    (
        "model = 'GIM3505-8'",
        "model = 'A4' #!",
        "motor.model",
        "unknown model \"A4\"; known are GIM3505-8, GIM3510-8, ",
    ),
    (
        "model = 'GIM3505-8'",
        "model = 'GIM3505' #!",
        "motor.model",
        "unknown model \"GIM3505\"; did you mean `GIM3505-8`?",
    ),
    (
        "bus = 'gripper'",
        "bus = 'griper' #!",
        "motor.bus",
        "there is no bus \"griper\"; did you mean `gripper`?",
    ),
    ("damping-kd = 2.0", "direction = 2 #!", "motor.direction", "neither 1 nor -1"),
    // Buses.
    (
        "type = 'simulated'",
        "type = 'socketcan'\ninterface = 'a name too long' #!",
        "bus.interface",
        "cannot be an interface",
    ),
    (
        "type = 'simulated'",
        "type = 'socketcan'\ninterface = '../can0' #!",
        "bus.interface",
        "cannot be an interface",
    ),
    ("type = 'simulated'", "type = 'can' #!", "bus.type", "unknown value `can`"),
    (
        "type = 'simulated'",
        "type = 'simulated'\ninterface = 'can0' #!",
        "bus.interface",
        "does not belong to",
    ),
    (
        "[[bus]]\nname = 'front'\ntype = 'simulated'",
        "[[bus]] #!\nname = 'front'\ntype = 'simulated'\nbitrate = 250000",
        "bus",
        "at most 414 Hz",
    ),
    // Rates and times.
    ("rate-hz = 1000", "rate-hz = 0 #!", "cycle.rate-hz", "0 is out of range"),
    ("rate-hz = 1000", "rate-hz = 1e9 #!", "cycle.rate-hz", "1000000000 is out of range"),
    ("rate-hz = 1000", "busy-poll-us = 1000 #!", "cycle.busy-poll-us", "not shorter than a cycle"),
    ("mode = 'timed'", "lead-us = 2000 #!", "exchange.lead-us", "not shorter than a cycle"),
    (
        "setpoint-timeout-ms = 20",
        "setpoint-timeout-ms = 0 #!",
        "safety.setpoint-timeout-ms",
        "0 is out of range",
    ),
    (
        "setpoint-timeout-ms = 20",
        "setpoint-timeout-ms = 1001 #!",
        "safety.setpoint-timeout-ms",
        "out of range",
    ),
    (
        "setpoint-timeout-ms = 20",
        "setpoint-timeout-ms = 1.5 #!",
        "safety.setpoint-timeout-ms",
        "less than 2 cycles",
    ),
    ("setpoint-timeout-ms = 20", "deadman-ms = 1.0 #!", "safety.deadman-ms", "less than 2 cycles"),
    ("rate-hz = 1000", "priority = 0 #!", "cycle.priority", "0 is out of range"),
    ("rate-hz = 1000", "priority = 99 #!", "cycle.priority", "99 is out of range"),
    ("rate-hz = 1000", "cpu = 4096 #!", "cycle.cpu", "processor 4096 is not online"),
    ("rate-hz = 1000", "cpu = -1 #!", "cycle.cpu", "processor -1 is not online"),
    // A safe stop that could not damp.
    ("damping-kd = 2.0", "damping-kd = 0 #!", "motor.damping-kd", "0 does not damp"),
    ("damping-kd = 2.0", "damping-kd = 5.5 #!", "motor.damping-kd", "out of range"),
    ("kd-max = 5.0", "kd-max = 1.0", "motor.damping-kd", "could not apply it"),
    // Groups.
    (
        "joints = ['jaw']",
        "joints = ['jav'] #!",
        "group.joints",
        "there is no motor \"jav\"; did you mean `jaw`?",
    ),
    (
        "joints = ['jaw']",
        "joints = ['jaw', 'hip'] #!",
        "group.joints",
        "\"hip\" is in group \"legs\" already",
    ),
    (
        "joints = ['jaw']",
        "joints = ['jaw', 'jaw'] #!",
        "group.joints",
        "\"jaw\" is in group \"hand\" already",
    ),
    ("joints = ['jaw']", "joints = [] #!", "group.joints", "has no joints"),
    ("joints = ['hip', 'knee']", "joints = ['hip']", "group", "motor \"knee\" is in no group"),
];

/// The serial bus of [`with_serial`], and the mistakes that must be reported of it.
const SERIAL_BUS: &str = "type = 'serial'\ndevice = '/dev/null'\nevery = 2\n";
const SERIAL: &[Case] = &[
    ("device = '/dev/null'", "", "bus.device", "is missing"),
    ("device = '/dev/null'", "device = 'ttyUSB0' #!", "bus.device", "no absolute path"),
    ("protocol = 'gim'", "protocol = 'mit' #!", "motor.protocol", "MIT is spoken over CAN only"),
    (
        "every = 2",
        "every = 1 #!",
        "bus.every",
        "2 turns of 760 µs do not fit into 1 cycles of this serial bus; give it every = 2",
    ),
    ("every = 2", "every = 2 #!\nbaud = 115200", "bus.every", "give it every = 6"),
    ("every = 2", "every = 2 #!\nturnaround-us = 1500", "bus.every", "give it every = 4"),
    ("every = 2", "every = 70 #!", "bus.every", "needs 15 to start"),
    (
        "[[bus]]\nname = 'gripper'",
        "[[bus]]\nname = 'first'\ntype = 'serial'\ndevice = '/dev/null'\n[[bus]]\nname = 'gripper'",
        "bus.device",
        "two buses cannot share it",
    ),
];

/// [`GOOD`] with its gripper on a serial bus.
fn with_serial() -> String {
    let (before, bus) = GOOD.split_once("name = 'gripper'\n").expect("it has one");
    format!("{before}name = 'gripper'\n{}", bus.replacen("type = 'simulated'\n", SERIAL_BUS, 1))
}

/// A machine that allows everything, whatever the one that runs the tests does.
fn machine() -> Machine {
    Machine { processors: vec![0, 1], priority_max: 98 }
}

fn judge(text: &str) -> Result<Loaded, ConfigError> {
    parse(Path::new("robot.toml"), text.as_bytes(), &machine())
}

fn damaged(line: &str, instead: &str) -> String {
    assert!(GOOD.contains(line), "nothing to damage: {line}");
    GOOD.replacen(line, instead, 1)
}

fn marked_line(text: &str) -> Option<usize> {
    text.lines().position(|line| line.ends_with(MARK)).map(|index| index + 1)
}

/// The one error of a configuration.
fn only_error(text: &str) -> String {
    let error = judge(text).expect_err("must be refused").to_string();
    assert_eq!(error.lines().count(), 1, "one mistake, one line:\n{error}");
    error
}

fn warnings(text: &str) -> Vec<String> {
    judge(text).expect("may be run").warnings.iter().map(ToString::to_string).collect()
}

/// The message about a limit names the highest usable one, at the motor; at the joint it is a sum that rounds.
#[test]
fn recommended_position_limit_is_accepted_with_every_offset() {
    for tenths in -125..=125 {
        let offset = f64::from(tenths) / 10.0;
        let (low, high) = (offset - 12.4375, offset + 12.4375);
        let text = damaged(
            "damping-kd = 2.0\n[motor.limits]\nposition-rad = [-1.2, 1.2]",
            &format!("offset-rad = {offset}\n[motor.limits]\nposition-rad = [{low}, {high}]"),
        );
        if let Err(error) = judge(&text) {
            panic!("{offset}: {error}");
        }
    }
}

/// Their codes are torques, so a current's constant would change nothing.
#[test]
fn constant_without_effect_on_codes_is_refused() {
    for (key, value) in [("torque-constant-nm-per-a", 0.1), ("gear-ratio", 8.0)] {
        for model in ["DM-J4310-2EC", "RS00"] {
            let text = damaged(
                "id = 2\nprotocol = 'mit'\nmodel = 'GIM8108-8'",
                &format!("id = 2\nprotocol = 'mit'\nmodel = '{model}'\n{key} = {value} #!"),
            );
            let error = only_error(&text);
            assert!(error.contains(&format!(": motor.{key}: has no effect on")), "{error}");
        }
    }
}

#[test]
fn the_configuration_that_the_tests_damage_is_good() {
    assert_eq!(warnings(GOOD), [""; 0]);
}

#[test]
fn bad_configuration_is_refused_with_line_and_key() {
    for (line, instead, key, reason) in REFUSED {
        let text = damaged(line, instead);
        let error = only_error(&text);
        if let Some(marked) = marked_line(&text) {
            let place = format!("robot.toml:{marked}: ");
            assert!(error.starts_with(&place), "{instead}: expected {place}, got {error}");
        }
        assert!(
            key.is_empty() || error.contains(&format!(": {key}: ")),
            "{instead}: expected {key}, got {error}"
        );
        assert!(error.contains(reason), "{instead}: expected {reason}, got {error}");
    }
}

#[test]
fn serial_bus_mistake_is_refused_with_key() {
    for (line, instead, key, reason) in SERIAL {
        let text = with_serial();
        assert!(text.contains(line), "nothing to damage: {line}");
        let error = judge(&text.replacen(line, instead, 1)).expect_err("must be refused").to_string();
        let complaint =
            error.lines().find(|error| error.contains(&format!(" {key}: ")) && error.contains(reason));
        assert!(complaint.is_some(), "{instead}: expected {key}: {reason}, got {error}");
    }
}

#[test]
fn serial_bus_uses_configured_turnaround_and_turns() {
    let settings = judge(&with_serial()).expect("it is good").settings;
    let bus = settings.buses.iter().find(|bus| bus.name == "gripper").expect("it has one");
    let BusKind::Serial { device, baud, turnaround } = &bus.kind else { panic!("{:?}", bus.kind) };
    assert_eq!((device.as_str(), *baud, bus.every.get()), ("/dev/null", 921_600, 2));
    assert_eq!(*turnaround, std::time::Duration::from_micros(500));
}

#[test]
fn check_prints_contract_and_exits_78_when_bad() {
    let folder = TempDir::new().unwrap();
    for (line, instead, ..) in REFUSED {
        let file = write(&folder, &damaged(line, instead));
        let mut out = Vec::new();
        assert_eq!(check(&file, JSON, &mut out).unwrap(), EXIT_CONFIG, "{instead}");
        let report: serde_json::Value = serde_json::from_slice(&out).unwrap();
        let first = report["errors"][0].as_str().unwrap();
        assert!(first.starts_with(&format!("{}:", file.display())), "{first}");
        assert_eq!(report["warnings"], serde_json::json!([]));
        assert!(report["buses"].is_array() && report["joints"].is_null(), "{report}");
    }
}

/// Goal: who has put too much on a bus sees how much, and what would fit, in JSON and as text.
/// Method: a fourth motor on a bus of the shipped robot; a line whose turns overlap; a file of which no bus can be built.
#[test]
fn the_plan_of_a_refused_bus_is_shown() {
    let folder = TempDir::new().unwrap();
    let quadruped = fs::read_to_string(shipped("quadruped-simulated.toml")).unwrap();
    let five = quadruped.replacen("rate-hz = 1000", "rate-hz = 1500", 1);
    let line = with_serial().replacen("every = 2", "every = 1", 1);
    for (text, bus, advice) in [
        (five, "front-left", "TOO FULL: lower the rate or move a motor"),
        (line, "gripper", "TOO FULL: it needs every = 2"),
    ] {
        let file = write(&folder, &text);
        let (mut json, mut said) = (Vec::new(), Vec::new());
        assert_eq!(check(&file, JSON, &mut json).unwrap(), EXIT_CONFIG);
        assert_eq!(check(&file, TEXT, &mut said).unwrap(), EXIT_CONFIG);
        let report: serde_json::Value = serde_json::from_slice(&json).unwrap();
        let buses = report["buses"].as_array().unwrap();
        let planned = buses.iter().find(|planned| planned["name"] == bus).unwrap();
        let overlaps = planned["line"]["every_least"].as_f64() > planned["every"].as_f64();
        let rate_hz = if bus == "front-left" { 1500.0 } else { 1000.0 };
        assert!(planned["rate_hz_max"].as_f64() < Some(rate_hz), "{planned}");
        assert!(bus == "front-left" || overlaps, "{planned}");
        let said = String::from_utf8(said).unwrap();
        assert!(said.lines().any(|line| line.starts_with(bus) && line.contains(advice)), "{said}");
        assert!(said.lines().last().unwrap().contains("is refused, errors: "), "{said}");
    }
    let unknown = write(&folder, &damaged("model = 'GIM3505-8'", "model = 'GIM3505-9'"));
    let mut json = Vec::new();
    assert_eq!(check(&unknown, JSON, &mut json).unwrap(), EXIT_CONFIG);
    let report: serde_json::Value = serde_json::from_slice(&json).unwrap();
    assert_eq!(report["buses"], serde_json::json!([]));
}

/// Goal: one run tells every mistake, of whatever kind, in the order of the file.
/// Method: a file with mistakes of spelling, type, range, reference, between keys, and a missing key.
#[test]
fn all_mistakes_are_reported_in_one_run() {
    let mistakes = [
        ("rate-hz = 1000", "rate-hz = 0", "cycle.rate-hz: 0 is out of range"),
        ("mode = 'timed'", "mode = 'fast'", "exchange.mode: unknown value `fast`"),
        (
            "setpoint-timeout-ms = 20",
            "setpoint-timeout-ms = 'long'",
            "safety.setpoint-timeout-ms: expected a number",
        ),
        ("name = 'gripper'", "name = 'gripper'\nseed = 1.5", "bus.seed: expected an integer"),
        ("damping-kd = 2.0", "dampng-kd = 2.0", "motor.dampng-kd: unknown key"),
        ("position-rad = [-1.2, 1.2]", "position-rad = [1.2, -1.2]", "motor.limits.position-rad: the lowest"),
        ("kp-max = 200.0", "kp-max = 501", "motor.limits.kp-max: 501 is beyond"),
        ("id = 2\nprotocol = 'mit'", "id = 2", "motor.protocol: is missing"),
        ("model = 'GIM3505-8'", "model = 'GIM3505-9'", "motor.model: unknown model"),
        ("joints = ['jaw']", "joints = ['jav']", "group.joints: there is no motor"),
    ];
    let text =
        mistakes.iter().fold(GOOD.to_owned(), |text, (line, instead, _)| text.replacen(line, instead, 1));
    let error = judge(&text).expect_err("must be refused").to_string();
    assert_eq!(error.lines().count(), mistakes.len(), "{error}");
    for (line, (.., expected)) in error.lines().zip(mistakes) {
        assert!(line.contains(expected), "expected {expected}, got {line}");
    }
}

/// Nobody can mend what only follows from another mistake.
#[test]
fn bad_bus_or_motor_is_reported_once() {
    for (line, instead) in [
        ("name = 'front'", "name = 3"),
        ("type = 'simulated'", "type = 'virtual'"),
        ("name = 'hip'", ""),
        ("model = 'GIM8108-8'", "model = 'X'"),
        ("bus = 'front'", "bus = 1"),
    ] {
        only_error(&damaged(line, instead));
    }
}

#[test]
fn one_bracket_or_two_is_told() {
    let single = "[bus]\nname = 'can'\ntype = 'simulated'\n[[motor]]\nname = 'm'\nbus = 'can'\nid = 1\n\
                  protocol = 'mit'\nmodel = 'GIM8108-8'\n";
    let expected =
        "robot.toml:1: bus: there can be several of this table; write `[[bus]]`, with two brackets";
    assert_eq!(only_error(single), expected, "the rest of the file is judged as if there were two");
    let twice = only_error(&format!("{single}[bus]\nname = 'b'\n"));
    assert_eq!(twice, "robot.toml:10: `bus`: is there twice; write `[[bus]]`, with two brackets, each time");
    let expected = "robot.toml:4: cycle: there is only one such table; write `[cycle]`, with one bracket";
    assert_eq!(only_error(&damaged("[cycle]", "[[cycle]]")), expected);
    assert!(
        only_error(&damaged("[cycle]\nrate-hz = 1000", "[daemon.cycle]")).contains("unknown key `cycle`")
    );
    assert!(
        judge("bus = 3").expect_err("no table").to_string().contains("expected a table, found an integer")
    );
}

#[test]
fn key_in_wrong_table_names_its_place() {
    let error = only_error(&damaged("kd-max = 5.0", "kd-max = 5.0\ndirection = -1"));
    assert!(
        error.contains("motor.limits.direction: unknown key `direction`; it belongs in [[motor]]"),
        "{error}"
    );
    let error = only_error(&damaged("rate-hz = 1000", "setpoint-timeout-ms = 20"));
    assert!(error.contains("; it belongs in [safety]"), "{error}");
}

#[test]
fn angle_beyond_a_turn_suggests_degrees() {
    let hint = "is it in degrees? 90° is 1.5708 rad";
    let refused = [
        (
            "position-rad = [-1.2, 1.2]",
            "position-rad = [-1.2, 90]",
            "motor.limits.position-rad: 90 is beyond ±12.5",
        ),
        ("damping-kd = 2.0", "offset-rad = 90", "motor.offset-rad: 90 is out of range"),
        ("setpoint-timeout-ms = 20", "start-jump-rad = 90", "safety.start-jump-rad: 90 is out of range"),
        (
            "damping-kd = 2.0",
            "simulation = { initial-position-rad = 90 }",
            "initial-position-rad: 90 rad is outside",
        ),
    ];
    for (line, instead, reason) in refused {
        let error = only_error(&damaged(line, instead));
        assert!(error.contains(reason) && error.contains(hint), "{error}");
    }
    let warned = warnings(&damaged("position-rad = [-1.2, 1.2]", "position-rad = [-9, 1.2]"));
    assert!(
        warned[0].contains("-9 rad is more than a turn; is it in degrees? -9° is -0.1571 rad"),
        "{warned:?}"
    );
    let wrapped = damaged("damping-kd = 2.0", "beyond-range = 'wrap'");
    let wrapped = wrapped.replacen("position-rad = [-1.2, 1.2]", "position-rad = [-90, 90]", 1);
    assert_eq!(warnings(&wrapped), [""; 0], "a joint of many turns is meant so");
}

#[test]
fn ipc_table_has_one_of_two_names() {
    let mode = |text: &str| judge(text).expect("is good").settings.ipc.mode;
    let spin = damaged("mode = 'timed'", "mode = 'spin'");
    assert_eq!(mode(&spin), IpcMode::Spin);
    assert_eq!(mode(&spin.replacen("[exchange]", "[ipc]", 1)), IpcMode::Spin);
    let both = damaged("[safety]", "[ipc]\nmode = 'spin'\n[safety]");
    let expected = "robot.toml:6: exchange: `[exchange]` is the old name of `[ipc]`, and both are there; \
                    move its keys to `[ipc]`";
    assert_eq!(only_error(&both), expected);
    let bad = damaged("mode = 'timed'", "lead-us = 0");
    assert!(only_error(&bad).contains(" exchange.lead-us: 0 is out of range"), "the name as it is written");
    assert!(only_error(&bad.replacen("[exchange]", "[ipc]", 1)).contains(" ipc.lead-us: 0 is out of range"));
}

#[test]
fn number_out_of_range_shows_range_and_unit() {
    let error = only_error(&damaged("rate-hz = 1000", "rate-hz = 10001"));
    assert!(error.ends_with("10001 is out of range; give a number from 1 to 10000 Hz"), "{error}");
    let error = only_error(&damaged("torque-nm = 20.0", "torque-nm = 0"));
    assert!(error.ends_with("0 is out of range; give a number of at least 0.01 N·m"), "{error}");
    let error = only_error(&damaged("id = 2", "id = 99999999999999999999"));
    assert!(error.ends_with("motor.id: the integer has too many digits"), "{error}");
}

#[test]
fn an_empty_file_says_what_the_least_is() {
    let error = judge("").expect_err("must be refused").to_string();
    let missing =
        ["bus", "motor"].map(|key| format!("robot.toml:1: {key}: is missing; motord needs at least one"));
    assert_eq!(error, missing.join("\n"));
    let without_motor = "[[bus]]\nname = 'a'\ntype = 'simulated'\n";
    assert_eq!(only_error(without_motor), "robot.toml:1: motor: is missing; motord needs at least one");
}

#[test]
fn text_without_utf8_is_refused_with_line() {
    let error =
        parse(Path::new("robot.toml"), b"[cycle]\nrate-hz = \xff\n", &machine()).expect_err("not UTF-8");
    assert_eq!(error.to_string(), "robot.toml:2: is not UTF-8 here; save the file as UTF-8");
}

#[test]
fn no_file_writes_control_characters_to_the_terminal() {
    for (line, instead) in [
        ("rate-hz = 1000", "\"a\\u001b[2Jb\" = 1"),
        ("mode = 'timed'", "mode = \"\\u001b[2J\""),
        ("name = 'knee'", "name = \"\\u001b[2J\\n\""),
        ("bus = 'gripper'", "bus = \"\\u001b[2J\""),
    ] {
        let error = judge(&damaged(line, instead)).expect_err("must be refused").to_string();
        assert!(!error.replace('\n', "").contains(char::is_control), "{error:?}");
        assert!(
            error.lines().all(|line| line.starts_with("robot.toml:")),
            "one problem, one line: {error:?}"
        );
    }
}

#[test]
fn five_motors_exceed_a_bus_at_1_khz() {
    let motor = |id| {
        format!("[[motor]]\nname = 'm{id}'\nbus = 'b'\nid = {id}\nprotocol = 'mit'\nmodel = 'GIM8108-8'\n")
    };
    let text = |count| {
        let motors: String = (1..=count).map(motor).collect();
        format!("[[bus]]\nname = 'b'\ntype = 'simulated'\n{motors}")
    };
    let error = only_error(&text(5));
    assert!(error.contains("5 motors arrives 1215 µs") && error.contains("at most 658 Hz"), "{error}");
    for (count, rate_hz) in [(1, 2588), (3, 1085), (4, 819), (6, 550)] {
        let at = |rate_hz: u32| format!("[cycle]\nrate-hz = {rate_hz}\n{}", text(count));
        let error = only_error(&at(rate_hz + 2));
        assert!(error.contains(&format!("lower cycle.rate-hz to at most {rate_hz} Hz")), "{error}");
        assert!(judge(&at(rate_hz)).is_ok());
    }
    let warned = warnings(&format!("[cycle]\nrate-hz = 819\n{}", text(4)));
    assert!(warned[0].contains("81.9 %") && warned[0].contains("at most 80 % is sound"), "{warned:?}");
    assert!(warned[1].contains("faults are asked for only in cycles"), "{warned:?}");
    assert_eq!(warnings(&text(3)), [""; 0]);
    let error = judge(&text(65)).expect_err("must be refused").to_string();
    assert!(error.contains("more than 64"), "{error}");
}

/// GIM8108-8: 0x100 + id. DM-J4340-2EC: 0x10 + id, beside which 0x100 + id is a command to the motor itself.
#[test]
fn wrong_reply_id_suggests_vendor_default() {
    for (model, default) in [("GIM8108-8", "0x102"), ("DM-J4340-2EC", "0x012")] {
        let text = format!(
            "[[bus]]\nname = 'leg'\ntype = 'simulated'\n[[motor]]\nname = 'knee'\nbus = 'leg'\nid = 2\nhost-id = 2\n\
             protocol = 'mit'\nmodel = '{model}'\n[motor.limits]\nposition-rad = [-1, 1]\nvelocity-rad-s = 5\n\
             torque-nm = 5\ntorque-slew-nm-per-s = 50\n"
        );
        let error = judge(&text).expect_err("it is a command id").to_string();
        assert!(error.contains(&format!("the default of this motor is {default}")), "{error}");
    }
}

#[test]
fn reply_id_above_commands_is_a_warning() {
    let warned = warnings(&GOOD.replacen("id = 2", "id = 0x20\nhost-id = 0x10", 1));
    assert!(
        warned[0].contains("motor.host-id: replies with id 0x010 outrank commands with id 0x020"),
        "{warned:?}"
    );
}

/// Its drive brakes it: no damping is neither too little nor too much for it.
#[test]
fn damping_of_native_motor_is_a_warning() {
    assert_eq!(warnings(GOOD).len(), 0);
    for damping in [2.0, 0.0] {
        let native = format!("model = 'GIM3505-8'\ndamping-kd = {damping:?}");
        let warned = warnings(&GOOD.replacen("model = 'GIM3505-8'", &native, 1));
        assert_eq!(warned.len(), 1, "{warned:?}");
        assert!(warned[0].contains("motor.damping-kd: a GIM motor does not use it"), "{warned:?}");
    }
}

#[test]
fn shared_host_id_on_line_is_one_warning() {
    let motor = |id: u8, more: &str| {
        format!(
            "[[motor]]\nname = 'm{id}'\nbus = 'b'\nid = {id}\nprotocol = 'gim'\nmodel = 'GIM8108-8'\n{more}\n"
        )
    };
    let line = |hosts: [&str; 3]| {
        let motors: String = (1..).zip(hosts).map(|(id, host)| motor(id, host)).collect();
        let text = format!("[[bus]]\nname = 'b'\ntype = 'serial'\ndevice = '/dev/null'\nevery = 5\n{motors}");
        warnings(&text)
    };
    let warned = line(["", "", ""]);
    assert_eq!(warned.len(), 1, "{warned:?}");
    for part in ["motor.host-id: host id 0x00", "\"m1\"", "give every motor of the line its own"] {
        assert!(warned[0].contains(part), "{warned:?}");
    }
    assert_eq!(line(["host-id = 0x41", "host-id = 0x42", "host-id = 0x43"]), [""; 0]);
    assert_eq!(line(["host-id = 0x41", "host-id = 0x42", "host-id = 0x42"]).len(), 1);
}

/// Without a key the switch waits for every daemon that is no later than it may be.
#[test]
fn too_eager_dead_mans_switch_is_a_warning() {
    for (text, expected_ms) in [("rate-hz = 1000", 7), ("rate-hz = 250", 13), ("max-lateness-ms = 100", 102)]
    {
        let Loaded { settings, warnings, .. } = judge(&GOOD.replacen("rate-hz = 1000", text, 1)).unwrap();
        assert_eq!(settings.safety.deadman, Duration::from_millis(expected_ms), "{text}");
        assert!(warnings.is_empty(), "{text}: {warnings:?}");
    }
    let warned = warnings(&GOOD.replacen("setpoint-timeout-ms = 20", "deadman-ms = 5", 1));
    assert!(warned[0].contains("safety.deadman-ms") && warned[0].contains("at least 7 ms"), "{warned:?}");
}

#[test]
fn missing_interface_is_a_warning() {
    let socketcan = "type = 'socketcan'\ninterface = 'nocan7'";
    let warned = warnings(&GOOD.replacen("type = 'simulated'", socketcan, 1));
    assert!(warned[0].contains("bus.interface: there is no interface \"nocan7\""), "{warned:?}");
}

#[test]
fn excessive_priority_is_error_only_if_realtime_required() {
    let limited = Machine { priority_max: 0, ..machine() };
    let judge =
        |cycle: &str| parse(Path::new("robot.toml"), damaged("rate-hz = 1000", cycle).as_bytes(), &limited);
    assert!(judge("rate-hz = 1000").expect("may be run").warnings.is_empty(), "nobody asked for a priority");
    let warned = judge("priority = 80").expect("may be run").warnings;
    assert!(warned[0].to_string().contains("SCHED_FIFO 80 is beyond what motord may take here (0)"));
    let refused = judge("require-realtime = true").expect_err("must be refused").to_string();
    assert!(
        refused.starts_with("robot.toml:5: cycle.require-realtime: SCHED_FIFO 80 is beyond"),
        "{refused}"
    );
}

#[test]
fn metrics_go_to_file_and_no_network() {
    let with = |telemetry: &str| format!("{GOOD}\n[telemetry]\n{telemetry}\n");
    let good = "prometheus-file = '/tmp/motord.prom'\nprometheus-listen = '[::1]:9464'";
    let telemetry = judge(&with(good)).expect("is good").telemetry;
    assert_eq!(telemetry.prometheus_file.as_deref(), Some(Path::new("/tmp/motord.prom")));
    assert_eq!(telemetry.prometheus_listen, Some("[::1]:9464".parse().unwrap()));
    assert_eq!(judge(GOOD).expect("is good").telemetry, Default::default(), "nothing is opened unasked");
    for file in ["motord.prom", "/tmp/motord.txt", "/tmp/", ""] {
        let error = only_error(&with(&format!("prometheus-file = '{file}' #!")));
        assert!(error.contains("ends with .prom"), "{error}");
    }
    for address in ["0.0.0.0:9464", "192.168.0.1:9464", "localhost:9464", "127.0.0.1", "127.0.0.1:0", ""] {
        let error = only_error(&with(&format!("prometheus-listen = '{address}' #!")));
        assert!(error.contains("no loopback address"), "{error}");
    }
}

#[test]
fn spinning_ipc_thread_avoids_cycle_processor() {
    let text = damaged("mode = 'timed'", "mode = 'spin'\ncpu = 1").replace("rate-hz = 1000", "cpu = 1");
    assert!(only_error(&text).contains("exchange.cpu: the cycle uses processor 1 too"));
}

#[test]
fn ipc_priority_is_below_cycle_unless_spinning() {
    for (cycle, ipc, expected) in [
        ("priority = 40", "mode = 'timed'", Some(39)),
        ("priority = 1", "mode = 'timed'", Some(1)),
        ("priority = 40", "mode = 'timed'\npriority = 45", Some(45)),
        ("priority = 40", "mode = 'timed'\npriority = 0", None),
        ("priority = 40", "mode = 'spin'", None),
    ] {
        let text = damaged("mode = 'timed'", ipc).replace("rate-hz = 1000", cycle);
        let Loaded { settings, .. } = judge(&text).expect("is good");
        assert_eq!(settings.ipc.priority, expected, "{cycle}, {ipc}");
    }
}

#[test]
fn what_is_not_written_is_cautious() {
    let Loaded { settings, .. } = load(&shipped("minimal.toml")).expect("is shipped");
    assert_eq!(settings.instance, "robot");
    assert_eq!(settings.cycle.period, Duration::from_millis(1));
    assert_eq!(settings.cycle.reply_deadline, Duration::from_micros(800));
    assert_eq!(settings.cycle.max_lateness, Duration::from_millis(5));
    assert_eq!((settings.ipc.lead, settings.ipc.priority), (Duration::from_micros(20), Some(70)));
    assert_eq!(settings.safety.setpoint_timeout, Duration::from_millis(20));
    assert_eq!(settings.safety.deadman, Duration::from_millis(7));
    assert_eq!((settings.safety.safe_stop, settings.safety.lost_cycles), (SafeStop::Damp, 10));
    let motor = &settings.motors[0];
    assert_eq!((motor.id, motor.host_id.raw()), (1, 0x101));
    assert_eq!((motor.limits.torque, motor.limits.velocity), (7.5, 33.5), "rated torque, not peak");
    assert_eq!(motor.limits.position, [-12.0, 12.0]);
    assert_eq!((settings.groups[0].name.as_str(), &settings.groups[0].motors), ("all", &vec![0]));
}

#[test]
fn default_times_follow_a_slow_cycle() {
    let Loaded { settings, .. } =
        judge(&GOOD.replace("setpoint-timeout-ms = 20", "").replace("rate-hz = 1000", "rate-hz = 50"))
            .expect("is good");
    assert_eq!(settings.safety.setpoint_timeout, Duration::from_millis(40));
    assert_eq!(settings.safety.deadman, Duration::from_millis(45));
}

#[test]
fn a_simulated_motor_starts_where_its_joint_does() {
    let reversed = "direction = -1\noffset-rad = 0.5\nsimulation = { initial-position-rad = 0.8 }";
    let Loaded { settings, .. } = judge(&damaged("damping-kd = 2.0", reversed)).expect("is good");
    assert!((settings.simulation[0].initial_position + 0.3).abs() < 1e-6);
}

#[test]
fn the_hash_tells_one_file_from_another() {
    let hash = |text: &str| judge(text).expect("is good").hash;
    assert_eq!(hash(GOOD), hash(GOOD));
    assert_ne!(hash(GOOD), hash(&format!("{GOOD} ")));
}

#[test]
fn only_bounded_regular_files_are_read() {
    let folder = TempDir::new().unwrap();
    let refusal = |path: &Path| load(path).expect_err("must be refused").to_string();
    assert!(refusal(folder.path()).contains("is a directory"));
    assert!(refusal(Path::new("/dev/null")).contains("is a device"));
    assert!(refusal(&folder.path().join("nothing.toml")).contains("cannot be read"));
    let fifo = folder.path().join("fifo");
    nix::unistd::mkfifo(&fifo, nix::sys::stat::Mode::S_IRWXU).unwrap();
    assert!(refusal(&fifo).contains("is a FIFO"));
    let large = write(&folder, &"#".repeat(1024 * 1024 + 1));
    assert!(refusal(&large).contains("is larger than 1048576 bytes"));
}

#[test]
fn world_writable_file_is_refused_behind_link_too() {
    let folder = TempDir::new().unwrap();
    let file = write(&folder, GOOD);
    let link = folder.path().join("link.toml");
    symlink(&file, &link).unwrap();
    assert!(load(&link).is_ok(), "a link may choose a file");
    fs::set_permissions(&file, Permissions::from_mode(0o666)).unwrap();
    for path in [file, link] {
        let refusal = load(&path).expect_err("must be refused").to_string();
        assert!(refusal.contains("may be changed by every user of this machine"), "{refusal}");
    }
}

/// The names of the files that we ship, in order.
fn shipped_names() -> Vec<String> {
    let files = fs::read_dir(shipped("")).expect("it is there").map(|entry| entry.expect("it can be read"));
    let mut names: Vec<_> = files.map(|file| file.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn every_shipped_configuration_passes_check() {
    let names = shipped_names();
    for known in
        ["arm-gim.toml", "arm-native.toml", "minimal.toml", "quadruped-simulated.toml", "quadruped.toml"]
    {
        assert!(names.contains(&known.to_owned()), "{known} is among {names:?}");
    }
    for name in names {
        let mut out = Vec::new();
        assert_eq!(check(&shipped(&name), JSON, &mut out).unwrap(), 0, "{}", String::from_utf8_lossy(&out));
    }
}

#[test]
fn simulated_quadruped_plan_is_three_quarters_per_bus() {
    let mut out = Vec::new();
    assert_eq!(check(&shipped("quadruped-simulated.toml"), JSON, &mut out).unwrap(), 0);
    let report: serde_json::Value = serde_json::from_slice(&out).unwrap();
    let bus = |name| {
        serde_json::json!({
            "name": name, "motors": 3, "rate_hz": 1000.0, "every": 1, "worst_case_utilisation": 0.75,
            "unstuffed_utilisation": 0.618, "fault_poll_utilisation": 1.0, "rate_hz_max": 1085.0,
        })
    };
    let buses = ["front-left", "front-right", "rear-left", "rear-right"].map(bus);
    assert_eq!(report, serde_json::json!({ "errors": [], "warnings": [], "buses": buses }));
}

#[test]
fn check_says_the_same_to_people() {
    let mut out = Vec::new();
    assert_eq!(check(&shipped("quadruped-simulated.toml"), TEXT, &mut out).unwrap(), 0);
    let text = String::from_utf8(out).unwrap();
    let row = text.lines().find(|line| line.starts_with("rear-left")).unwrap();
    assert_eq!(
        row.split_whitespace().collect::<Vec<_>>().join(" "),
        "rear-left 3 75.0 % 61.8 % 100.0 % 1085 Hz fits"
    );
    for column in ["worst case", "unstuffed", "fault poll", "highest"] {
        let explained = text.lines().filter(|line| line.starts_with(column)).count();
        assert_eq!(explained, 1, "{column} is explained once:\n{text}");
    }
    assert!(text.lines().last().unwrap().ends_with("quadruped-simulated.toml may run"), "{text}");
}

/// A motor whose limits come from everywhere.
const ORIGINS: &str = "[cycle]
rate-hz = 500
[[bus]]
name = 'desk'
type = 'simulated'
[[motor]]
name = 'hip'
bus = 'desk'
id = 1
protocol = 'mit'
model = 'GIM8108-8'
[[motor]]
name = 'knee'
bus = 'desk'
id = 2
protocol = 'mit'
model = 'GIM8108-8'
offset-rad = 0.5
max-velocity-rad-s = 9.0
rated-torque-nm = 3.0
[motor.limits]
position-rad = [-1.0, 2.0]
kp-max = 60.0
temperature-max-celsius = 75.0
[[motor]]
name = 'wheel'
bus = 'desk'
id = 3
protocol = 'mit'
model = 'GIM8108-8'
peak-torque-nm = 2.0
[[motor]]
name = 'claw'
bus = 'desk'
id = 4
protocol = 'mit'
model = 'GIM8108-8'
torque-constant-nm-per-a = 0.001
";

/// Goal: an operator learns which line to change for another limit, or that no line gives it.
/// Method: the limits of four motors, as text and as JSON, against what their file says.
#[test]
fn every_effective_limit_says_where_it_comes_from() {
    let folder = TempDir::new().unwrap();
    let file = write(&folder, ORIGINS);
    let (mut json, mut said) = (Vec::new(), Vec::new());
    assert_eq!(check(&file, Wanted { joints: true, ..JSON }, &mut json).unwrap(), 0);
    assert_eq!(check(&file, Wanted { joints: true, ..TEXT }, &mut said).unwrap(), 0);
    let report: serde_json::Value = serde_json::from_slice(&json).unwrap();
    let said = String::from_utf8(said).unwrap();
    let line = |key: &str| 1 + ORIGINS.lines().position(|line| line.starts_with(key)).unwrap();
    let limit = |joint: usize, key: &str| {
        let limits = report["joints"][joint]["limits"].as_array().unwrap();
        limits.iter().find(|limit| limit["key"] == key).unwrap().clone()
    };
    for (joint, key, from) in [
        (0, "position-rad", "default".to_owned()),
        (0, "torque-nm", "rated torque of the model".to_owned()),
        (0, "kp-max", "default".to_owned()),
        (0, "torque-slew-nm-per-s", "50 · torque-nm".to_owned()),
        (0, "temperature-derate-celsius", "default".to_owned()),
        (0, "following-error-rad", "default".to_owned()),
        (1, "position-rad", format!("line {}", line("position-rad"))),
        (1, "velocity-rad-s", format!("max-velocity-rad-s in line {}", line("max-velocity"))),
        (1, "torque-nm", format!("rated-torque-nm in line {}", line("rated-torque"))),
        (1, "rated-torque-nm", format!("line {}", line("rated-torque"))),
        (1, "kp-max", format!("line {}", line("kp-max"))),
        (1, "temperature-derate-celsius", "10 below temperature-max-celsius".to_owned()),
        (2, "rated-torque-nm", format!("peak-torque-nm in line {}", line("peak-torque"))),
        (2, "torque-nm", format!("peak-torque-nm in line {}", line("peak-torque"))),
        (3, "torque-nm", "end of the protocol's scale".to_owned()),
    ] {
        assert_eq!(limit(joint, key)["from"], from.as_str(), "{key} of {joint}: {}", limit(joint, key));
        let row = |line: &&str| line.trim_start().starts_with(key) && line.ends_with(&from);
        assert!(said.lines().any(|line| row(&line)), "{key}: {from} in\n{said}");
    }
    let keys: Vec<_> =
        report["joints"][0]["limits"].as_array().unwrap().iter().map(|limit| &limit["key"]).collect();
    let written = fs::read_to_string(shipped("../docs/configuration.md")).unwrap();
    let section = written.split("\n## ").find(|section| section.starts_with("[motor.limits]")).unwrap();
    for row in section.lines().filter_map(|line| line.strip_prefix("| `")) {
        let key = row.split('`').next().unwrap();
        assert!(keys.contains(&&serde_json::json!(key)), "{key} is a limit without an origin");
    }
    let settings = load(&file).expect("is good").settings;
    for (joint, motor) in settings.motors.iter().enumerate() {
        let number = |key: &str| limit(joint, key)["max"].as_f64().map(|max| max as f32);
        assert_eq!(number("torque-nm"), Some(motor.limits.torque));
        assert_eq!(number("velocity-rad-s"), Some(motor.limits.velocity));
        assert_eq!(number("position-rad"), Some(motor.limits.position[1]));
        assert_eq!(number("following-error-rad"), motor.limits.following_error);
    }
    assert!(said.contains("following-error-rad         not watched"), "{said}");
}

/// The report as JSON, and as text.
const JSON: Wanted = Wanted { json: true, joints: false };
const TEXT: Wanted = Wanted { json: false, joints: false };

/// With `MOTORD_WRITE_DOCS` set, writes the tables of the reference instead.
#[test]
fn the_reference_is_current() {
    let path = shipped("../docs/configuration.md");
    let written = fs::read_to_string(&path).expect("the reference is there");
    let current = reference(&written);
    if std::env::var_os("MOTORD_WRITE_DOCS").is_some() {
        fs::write(&path, current).expect("the reference can be written");
    } else {
        let stale = current.lines().zip(written.lines()).find(|(now, then)| now != then);
        let advice = "MOTORD_WRITE_DOCS=1 cargo test -p motord --test config reference";
        assert!(current == written, "docs/configuration.md is not current, see {stale:#?}; {advice}");
    }
}

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../config").join(name)
}

fn write(folder: &TempDir, text: &str) -> PathBuf {
    let path = folder.path().join("robot.toml");
    fs::write(&path, text).expect("the temporary folder is writable");
    path
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = parse(Path::new("robot.toml"), &bytes, &machine());
    }

    /// Damage to a shipped file gets deeper into the judging than noise does: a piece of it moves to another place, or
    /// gives way to something else.
    #[test]
    fn damaged_shipped_file_never_panics_and_names_line(
        (file, at, removed) in (prop::sample::select(shipped_names()), any::<prop::sample::Index>(), 0_usize..40),
        moved in prop::option::of(any::<prop::sample::Index>()),
        inserted in "[-0-9.e'\"\\[\\]{}=,a-z\n#]{0,12}|\\[\\[?(bus|motor|group|cycle|ipc|exchange)\\]\\]?\n|nan|-inf|1e400",
    ) {
        let text = fs::read(shipped(&file)).unwrap();
        let at = at.index(text.len());
        let end = (at + removed).min(text.len());
        let mut damaged = [&text[..at], inserted.as_bytes(), &text[end..]].concat();
        if let Some(place) = moved {
            let place = place.index(damaged.len() + 1);
            damaged.splice(place..place, text[at..end].iter().copied());
        }
        if let Err(error) = parse(Path::new("robot.toml"), &damaged, &machine()) {
            prop_assert!(!error.problems.is_empty());
            let lines = 1 + damaged.iter().filter(|byte| **byte == b'\n').count();
            for problem in &error.problems {
                let place = problem.place.as_ref();
                prop_assert!(place.is_some_and(|place| (1..=lines).contains(&place.line)), "{}", problem);
                prop_assert!(!problem.to_string().contains(char::is_control), "{:?}", problem.to_string());
            }
        }
    }

    /// Damage to a good file gets deeper into the judging than noise does.
    #[test]
    fn damaged_file_never_panics_and_names_line(
        at in 0..GOOD.len(),
        removed in 0_usize..20,
        inserted in "[-0-9.e'\\[\\]=a-z\n#]{0,12}",
    ) {
        let end = (at + removed).min(GOOD.len());
        let text = format!("{}{inserted}{}", &GOOD[..at], &GOOD[end..]);
        if let Err(error) = judge(&text) {
            prop_assert!(!error.problems.is_empty());
            prop_assert!(error.problems.iter().all(|problem| problem.place.is_some()));
        }
    }

    /// Any number in place of any other: settings are finite, positive where they must be, and durations never panic.
    #[test]
    fn whatever_numbers_are_accepted_make_sane_settings(value in any::<f64>(), nth in 0_usize..12) {
        let numbers: Vec<_> = GOOD.match_indices("= ").filter(|(at, _)| GOOD.as_bytes()[at + 2].is_ascii_digit()).collect();
        let at = numbers[nth % numbers.len()].0 + 2;
        let line_end = at + GOOD[at..].find('\n').unwrap();
        let text = format!("{}{value:?}{}", &GOOD[..at], &GOOD[line_end..]);
        if let Ok(Loaded { settings, .. }) = judge(&text) {
            prop_assert!(settings.cycle.period >= Duration::from_micros(250));
            for motor in settings.motors {
                let (torque, kp) = (motor.limits.torque, motor.limits.kp);
                prop_assert!(torque > 0.0 && torque <= motor.winding.peak_torque && kp.is_finite());
            }
        }
    }
}
