//! Mistakes in a configuration, and the message for each.

use crate::document::{damaged, only_error, validate, warnings, with_serial};
use motord_configuration::{Problem, Wrong};

/// One mutation of [`GOOD`]: a line, its replacement, the key and the expected complaint. [`MARK`]
/// marks the line of the complaint.
pub(crate) type Case = (&'static str, &'static str, &'static str, &'static str);
const MARK: &str = "#!";

pub(crate) const REFUSED: &[Case] = &[
    // The text.
    ("rate-hz = 1000", "rate-hz = = 1 #!", "cycle.rate-hz", "found `=` twice; write rate-hz = 1"),
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
        "a command of this protocol has no duration",
    ),
    ("[cycle]", "[cycle #!", "cycle", "write [cycle], alone in its line"),
    (
        "kp-max = 200.0",
        "kp-mx = 200.0 #!",
        "motor.limits.kp-mx",
        "unknown key `kp-mx`; did you mean `kp-max`?",
    ),
    ("[safety]", "[saftey] #!", "saftey", "unknown table [saftey]; did you mean [safety]?"),
    (
        "rate-hz = 1000",
        "rate-hz = 1000\nrate-hz = 500 #!",
        "cycle.rate-hz",
        "`rate-hz` is there twice, first in line 5",
    ),
    ("rate-hz = 1000", "rate-hz = 'fast' #!", "cycle.rate-hz", "expected a number"),
    ("rate-hz = 1000", "cpu = 1.5 #!", "cycle.cpu", "expected an integer"),
    (
        "mode = 'timed'",
        "mode = 3 #!",
        "exchange.mode",
        "expected one of \"timed\", \"spin\", found the integer 3",
    ),
    ("mode = 'timed'", "mode = 'fast' #!", "exchange.mode", "unknown value `fast`; known are timed, spin"),
    ("instance = 'robot'", "instance = 'My/Robot' #!", "daemon.instance", "cannot be an instance"),
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
    // Scale and limits of the protocol.
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
    (
        "damping-kd = 2.0",
        "gear-ratio = -8 #!",
        "motor.gear-ratio",
        "from 1 to 200; a joint that turns against its motor has direction = -1",
    ),
    // Names, ids, models.
    (
        "name = 'hand'",
        "name = 'front-left-leg-of-the-second-robot' #!",
        "group.name",
        "\"front-left-leg-of-the-second-robot\" has 34 letters; use at most 32",
    ),
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
        "unknown model \"GIM9999-8\"; known are GIM3505-8, ",
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
    ("damping-kd = 2.0", "damping-kd = 5.5 #!", "motor.damping-kd", "5.5 is more than limits.kd-max 5"),
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
pub(crate) const SERIAL_BUS: &str = "type = 'serial'\ndevice = '/dev/null'\nevery = 2\n";
const SERIAL: &[Case] = &[
    ("device = '/dev/null'", "", "bus.device", "is missing"),
    ("device = '/dev/null'", "device = 'ttyUSB0' #!", "bus.device", "no absolute path"),
    ("protocol = 'gim'", "protocol = 'mit' #!", "motor.protocol", "\"mit\" is spoken over CAN only"),
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
    (
        "[[bus]]\nname = 'gripper'",
        "[[bus]]\nname = 'first'\ntype = 'serial'\ndevice = '/dev/../dev/null'\n[[bus]]\nname = 'gripper'",
        "bus.device",
        "\"/dev/null\" is another name of \"/dev/../dev/null\"",
    ),
];

fn marked_line(text: &str) -> Option<usize> {
    text.lines().position(|line| line.ends_with(MARK)).map(|index| index + 1)
}

#[test]
fn bad_configuration_is_refused_with_line_and_key() {
    for (line, instead, key, reason) in REFUSED {
        let text = damaged(line, instead);
        let error = only_error(&text);
        if let Some(marked) = marked_line(&text) {
            let location = format!("robot.toml:{marked}:");
            assert!(error.starts_with(&location), "{instead}: expected {location}, got {error}");
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
        let error = validate(&text.replacen(line, instead, 1)).expect_err("must be refused").to_string();
        let complaint =
            error.lines().find(|error| error.contains(&format!(" {key}: ")) && error.contains(reason));
        assert!(complaint.is_some(), "{instead}: expected {key}: {reason}, got {error}");
    }
}

// Settings that are permitted but are often mistakes: each causes a warning with its line and the
// remedy.

/// The warnings of this file's kinds.
pub(crate) fn implausible(warnings: &[Problem]) -> Vec<String> {
    use Wrong::{FasterThanModel, FasterThanMotor, NoPositionLimits, SlowMotors};
    let is_implausible = |wrong: &Wrong| {
        matches!(
            wrong,
            FasterThanModel { .. } | FasterThanMotor { .. } | NoPositionLimits { .. } | SlowMotors { .. }
        )
    };
    warnings.iter().filter(|problem| is_implausible(&problem.wrong)).map(ToString::to_string).collect()
}

/// The warnings of a configuration with `instead` in place of `line`.
fn warned(line: &str, instead: &str) -> Vec<String> {
    warnings(&damaged(line, instead))
}

#[test]
fn rate_too_slow_for_a_stop_is_warned() {
    let slow = damaged("rate-hz = 1000", "rate-hz = 1").replace("setpoint-timeout-ms = 20", "");
    assert_eq!(
        warnings(&slow),
        [
            "robot.toml:5:11: cycle.rate-hz: at 1 Hz a stop reaches the motors up to 1000 ms late, and the loss of a controller \
          is noticed after 2000 ms; give at least 50 Hz"
        ]
    );
    assert_eq!(warnings(&slow.replace("rate-hz = 1\n", "rate-hz = 50\n")), [""; 0]);
}

#[test]
fn line_of_rare_turns_is_warned() {
    let turns = with_serial().replacen("every = 2", "every = 40", 1);
    assert_eq!(
        warnings(&turns),
        [
            "robot.toml:17:9: bus.every: at 25 Hz a stop reaches the motors up to 40 ms late, and the loss of a controller is \
          noticed after 20 ms; give at least 50 Hz"
        ]
    );
}

#[test]
fn joint_without_position_limits_is_warned() {
    let all = damaged("position-rad = [-1.2, 1.2]\n", "");
    let expected = "is not given, so the joint may turn from -12 to 12 rad; write the ends of its travel, such as \
                    position-rad = [-0.5, 0.5]";
    assert_eq!(warnings(&all), [format!("robot.toml:23:1: motor.limits.position-rad: {expected}")]);
}

#[test]
fn velocity_beyond_the_motor_is_warned() {
    let printed = warned("velocity-rad-s = 30.0", "velocity-rad-s = 34.0");
    let expected = "robot.toml:25:18: motor.limits.velocity-rad-s: 34 rad/s is more than the 33.5 rad/s that the motor reaches \
                    without load, so it limits nothing; lower it, or give max-velocity-rad-s as it is at your supply voltage";
    assert_eq!(printed, [expected]);
    assert!(warned("velocity-rad-s = 30.0", "velocity-rad-s = 33.5").is_empty());
    let faster = damaged("damping-kd = 2.0", "max-velocity-rad-s = 40.0");
    assert!(
        validate(&faster.replace("velocity-rad-s = 30.0", "velocity-rad-s = 36.0"))
            .unwrap()
            .warnings
            .is_empty()
    );
}

/// A native motor has no velocity codes that would end below the written velocity.
#[test]
fn velocity_far_beyond_the_model_is_warned() {
    let written = |velocity: &str| {
        let faster = format!("model = 'GIM8108-8'\nmax-velocity-rad-s = {velocity}");
        warnings(&with_serial().replacen("model = 'GIM3505-8'", &faster, 1))
    };
    let [warning] = &written("300.0")[..] else { panic!("{:?}", written("300.0")) };
    assert!(
        warning.contains("motor.max-velocity-rad-s: 300 rad/s is 9.0 times the 33.5 rad/s that a GIM8108-8"),
        "{warning}"
    );
    assert_eq!(written("48.0"), [""; 0]);
}
