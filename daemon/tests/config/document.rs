//! All configurations that must be refused, with the reason, and the shipped ones, which must be
//! accepted.

use crate::mistakes::{REFUSED, SERIAL_BUS};
use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::time::Duration;

use motord::commands::check::{EXIT_CONFIG, Wanted, check};
use motord_bus::transport::Serial;
use motord_configuration::{ConfigError, Loaded, Machine, load, parse};
use motord_settings::settings::{IpcMode, SafeStop};
use tempfile::TempDir;

/// A configuration with nothing wrong, for the tests to damage.
pub(crate) const GOOD: &str = "
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
limits = { position-rad = [-2, 2] }
[[motor]]
name = 'jaw'
bus = 'gripper'
id = 1
protocol = 'gim'
model = 'GIM3505-8'
limits = { position-rad = [0, 1] }
[[group]]
name = 'legs'
joints = ['hip', 'knee']
[[group]]
name = 'hand'
joints = ['jaw']
";

/// [`GOOD`] with its gripper on a serial bus.
pub(crate) fn with_serial() -> String {
    let (before, bus) = GOOD.split_once("name = 'gripper'\n").expect("it has one");
    format!("{before}name = 'gripper'\n{}", bus.replacen("type = 'simulated'\n", SERIAL_BUS, 1))
}

/// Returns a machine that permits everything, independent of the machine that runs the tests.
pub(crate) fn machine() -> Machine {
    Machine { processors: vec![0, 1], priority_max: 98 }
}

pub(crate) fn validate(text: &str) -> Result<Loaded, ConfigError> {
    parse(Path::new("robot.toml"), text.as_bytes(), &machine())
}

pub(crate) fn damaged(line: &str, instead: &str) -> String {
    assert!(GOOD.contains(line), "nothing to damage: {line}");
    GOOD.replacen(line, instead, 1)
}

/// Returns the only error of a configuration.
pub(crate) fn only_error(text: &str) -> String {
    let error = validate(text).expect_err("must be refused").to_string();
    assert_eq!(error.lines().count(), 1, "one mistake, one line:\n{error}");
    error
}

pub(crate) fn warnings(text: &str) -> Vec<String> {
    validate(text).expect("may be run").warnings.iter().map(ToString::to_string).collect()
}

/// The message about a limit names the highest usable one, at the motor; at the joint it is a sum
/// that rounds.
#[test]
fn recommended_position_limit_is_accepted_with_every_offset() {
    for tenths in -125..=125 {
        let offset = f64::from(tenths) / 10.0;
        let (low, high) = (offset - 12.4375, offset + 12.4375);
        let text = damaged(
            "damping-kd = 2.0\n[motor.limits]\nposition-rad = [-1.2, 1.2]",
            &format!("offset-rad = {offset}\n[motor.limits]\nposition-rad = [{low}, {high}]"),
        );
        if let Err(error) = validate(&text) {
            panic!("{offset}: {error}");
        }
    }
}

/// Their codes are torques, so the constant of a current would have no effect.
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
fn serial_bus_uses_configured_turnaround_and_turns() {
    let settings = validate(&with_serial()).expect("it is good").settings;
    let bus = settings.buses.iter().find(|bus| bus.name == "gripper").expect("it has one");
    let turnaround = std::time::Duration::from_micros(500);
    assert_eq!(bus.kind, Serial { device: "/dev/null".into(), baud: 921_600, turnaround }.into());
    assert_eq!(bus.every.get(), 2);
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

/// Goal: the report of an overloaded bus contains its load and what would fit, in JSON and as text.
/// Method: a fourth motor on a bus of the shipped robot; a line whose turns overlap; a file from
/// which no bus can be built.
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
        let (mut json, mut printed) = (Vec::new(), Vec::new());
        assert_eq!(check(&file, JSON, &mut json).unwrap(), EXIT_CONFIG);
        assert_eq!(check(&file, TEXT, &mut printed).unwrap(), EXIT_CONFIG);
        let report: serde_json::Value = serde_json::from_slice(&json).unwrap();
        let buses = report["buses"].as_array().unwrap();
        let planned = buses.iter().find(|planned| planned["name"] == bus).unwrap();
        let overlaps = planned["line"]["every_least"].as_f64() > planned["every"].as_f64();
        let rate_hz = if bus == "front-left" { 1500.0 } else { 1000.0 };
        assert!(planned["rate_hz_max"].as_f64() < Some(rate_hz), "{planned}");
        assert!(bus == "front-left" || overlaps, "{planned}");
        let printed = String::from_utf8(printed).unwrap();
        assert!(printed.lines().any(|line| line.starts_with(bus) && line.contains(advice)), "{printed}");
        assert!(printed.lines().last().unwrap().contains("is refused, errors: "), "{printed}");
    }
    let unknown = write(&folder, &damaged("model = 'GIM3505-8'", "model = 'GIM3505-9'"));
    let mut json = Vec::new();
    assert_eq!(check(&unknown, JSON, &mut json).unwrap(), EXIT_CONFIG);
    let report: serde_json::Value = serde_json::from_slice(&json).unwrap();
    assert_eq!(report["buses"], serde_json::json!([]));
}

/// Goal: one run reports every mistake, of any kind, in the order of the file.
/// Method: a file with mistakes of spelling, type, range, reference, between keys, and a missing
/// key.
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
    let error = validate(&text).expect_err("must be refused").to_string();
    assert_eq!(error.lines().count(), mistakes.len(), "{error}");
    for (line, (.., expected)) in error.lines().zip(mistakes) {
        assert!(line.contains(expected), "expected {expected}, got {line}");
    }
}

/// Consequences of another mistake need no separate report.
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
        "robot.toml:1:1: bus: there can be several of this table; write `[[bus]]`, with two brackets";
    assert_eq!(only_error(single), expected, "the rest of the file is judged as if there were two");
    let twice = only_error(&format!("{single}[bus]\nname = 'b'\n"));
    assert_eq!(
        twice,
        "robot.toml:10:2: bus: is there twice, first in line 1; write `[[bus]]`, with two brackets, each time"
    );
    let expected = "robot.toml:4:1: cycle: there is only one such table; write `[cycle]`, with one bracket";
    assert_eq!(only_error(&damaged("[cycle]", "[[cycle]]")), expected);
    assert!(
        only_error(&damaged("[cycle]\nrate-hz = 1000", "[daemon.cycle]")).contains("unknown key `cycle`")
    );
    assert!(
        validate("bus = 3")
            .expect_err("no table")
            .to_string()
            .contains("expected a table, found the integer 3")
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
    let mode = |text: &str| validate(text).expect("is good").settings.ipc.mode;
    let spin = damaged("mode = 'timed'", "mode = 'spin'");
    assert_eq!(mode(&spin), IpcMode::Spin);
    assert_eq!(mode(&spin.replacen("[exchange]", "[ipc]", 1)), IpcMode::Spin);
    let both = damaged("[safety]", "[ipc]\nmode = 'spin'\n[safety]");
    let expected = "robot.toml:6:1: exchange: `[exchange]` is the old name of `[ipc]`, and both are there; \
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
    assert!(error.contains("motor.id: expected an integer from 0 to 254, found the integer 9999"), "{error}");
}

#[test]
fn missing_bus_or_motor_says_what_to_write() {
    let bus =
        "robot.toml:1:1: bus: is missing; motord needs at least one: write [[bus]] with its name and type";
    let motor = "robot.toml:1:1: motor: is missing; motord needs at least one: write [[motor]] with its name, bus, id, protocol and model";
    let error = validate("[cycle]\n").expect_err("must be refused").to_string();
    assert_eq!(error, format!("{bus}\n{motor}"));
    assert_eq!(only_error("[[bus]]\nname = 'a'\ntype = 'simulated'\n"), motor);
}

#[test]
fn text_without_utf8_is_refused_with_line() {
    let error =
        parse(Path::new("robot.toml"), b"[cycle]\nrate-hz = \xff\n", &machine()).expect_err("not UTF-8");
    assert_eq!(error.to_string(), "robot.toml:2:11: is not UTF-8 here; save the file as UTF-8");
}

#[test]
fn no_file_writes_control_characters_to_the_terminal() {
    for (line, instead) in [
        ("rate-hz = 1000", "\"a\\u001b[2Jb\" = 1"),
        ("mode = 'timed'", "mode = \"\\u001b[2J\""),
        ("name = 'knee'", "name = \"\\u001b[2J\\n\""),
        ("bus = 'gripper'", "bus = \"\\u001b[2J\""),
    ] {
        let error = validate(&damaged(line, instead)).expect_err("must be refused").to_string();
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
        format!(
            "[[motor]]\nname = 'm{id}'\nbus = 'b'\nid = {id}\nprotocol = 'mit'\nmodel = 'GIM8108-8'\n\
             limits.position-rad = [-1, 1]\n"
        )
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
        assert!(validate(&at(rate_hz)).is_ok());
    }
    let warned = warnings(&format!("[cycle]\nrate-hz = 819\n{}", text(4)));
    assert!(warned[0].contains("81.9 %") && warned[0].contains("at most 80 % is sound"), "{warned:?}");
    assert!(warned[1].contains("faults are asked for only in cycles"), "{warned:?}");
    assert_eq!(warnings(&text(3)), [""; 0]);
    let error = validate(&text(65)).expect_err("must be refused").to_string();
    assert!(error.contains("more than 64"), "{error}");
}

#[test]
fn reply_id_above_commands_is_a_warning() {
    let warned = warnings(&GOOD.replacen("id = 2", "id = 0x20\nhost-id = 0x10", 1));
    assert!(
        warned[0].contains("motor.host-id: replies with id 0x010 outrank commands with id 0x020"),
        "{warned:?}"
    );
}

/// The drive of this motor brakes it: every damping is acceptable.
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
            "[[motor]]\nname = 'm{id}'\nbus = 'b'\nid = {id}\nprotocol = 'gim'\nmodel = 'GIM8108-8'\n{more}\n\
             limits.position-rad = [-1, 1]\n"
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

/// Without a key the switch accepts any delay of a daemon that is within its limit.
#[test]
fn too_eager_dead_mans_switch_is_a_warning() {
    for (text, expected_ms) in [("rate-hz = 1000", 7), ("rate-hz = 250", 13), ("max-lateness-ms = 100", 102)]
    {
        let Loaded { settings, warnings, .. } = validate(&GOOD.replacen("rate-hz = 1000", text, 1)).unwrap();
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
    let validate =
        |cycle: &str| parse(Path::new("robot.toml"), damaged("rate-hz = 1000", cycle).as_bytes(), &limited);
    assert!(
        validate("rate-hz = 1000").expect("may be run").warnings.is_empty(),
        "nobody asked for a priority"
    );
    let warned = validate("priority = 80").expect("may be run").warnings;
    assert!(warned[0].to_string().contains("SCHED_FIFO 80 is beyond what motord may take here (0)"));
    let refused = validate("require-realtime = true").expect_err("must be refused").to_string();
    assert!(
        refused.starts_with("robot.toml:5:20: cycle.require-realtime: SCHED_FIFO 80 is beyond"),
        "{refused}"
    );
}

#[test]
fn metrics_go_to_file_and_no_network() {
    let with = |telemetry: &str| format!("{GOOD}\n[telemetry]\n{telemetry}\n");
    let good = "prometheus-file = '/tmp/motord.prom'\nprometheus-listen = '[::1]:9464'";
    let telemetry = validate(&with(good)).expect("is good").telemetry;
    assert_eq!(telemetry.prometheus_file.as_deref(), Some(Path::new("/tmp/motord.prom")));
    assert_eq!(telemetry.prometheus_listen, Some("[::1]:9464".parse().unwrap()));
    assert_eq!(validate(GOOD).expect("is good").telemetry, Default::default(), "nothing is opened unasked");
    for file in ["motord.prom", "/tmp/motord.txt", "/tmp/", ""] {
        let error = only_error(&with(&format!("prometheus-file = '{file}' #!")));
        assert!(error.contains("ends with .prom"), "{error}");
    }
    for address in ["0.0.0.0:9464", "192.168.0.1:9464", "localhost:9464", "127.0.0.1", "127.0.0.1:0", ""] {
        let error = only_error(&with(&format!("prometheus-listen = '{address}' #!")));
        assert!(error.contains("no loopback address"), "{error}");
    }
    let named = validate(&with("prometheus-hosts = ['robot.lan']")).expect("is good").telemetry;
    assert_eq!(named.prometheus_hosts, ["robot.lan"]);
    for host in ["robot.lan:9464", "http://robot.lan", "a b", ""] {
        let error = only_error(&with(&format!("prometheus-hosts = ['{host}'] #!")));
        assert!(error.contains("no host name"), "{error}");
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
        let Loaded { settings, .. } = validate(&text).expect("is good");
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
    assert_eq!(motor.limits.position, [-0.5, 0.5]);
    assert_eq!((settings.groups[0].name.as_str(), &settings.groups[0].motors), ("all", &vec![0]));
}

#[test]
fn default_times_follow_a_slow_cycle() {
    let Loaded { settings, .. } =
        validate(&GOOD.replace("setpoint-timeout-ms = 20", "").replace("rate-hz = 1000", "rate-hz = 50"))
            .expect("is good");
    assert_eq!(settings.safety.setpoint_timeout, Duration::from_millis(40));
    assert_eq!(settings.safety.deadman, Duration::from_millis(45));
}

#[test]
fn a_simulated_motor_starts_where_its_joint_does() {
    let reversed = "direction = -1\noffset-rad = 0.5\nsimulation = { initial-position-rad = 0.8 }";
    let Loaded { settings, .. } = validate(&damaged("damping-kd = 2.0", reversed)).expect("is good");
    assert!((settings.simulation[0].initial_position + 0.3).abs() < 1e-6);
}

#[test]
fn the_hash_tells_one_file_from_another() {
    let hash = |text: &str| validate(text).expect("is good").hash;
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

/// The report as JSON, and as text.
pub(crate) const JSON: Wanted = Wanted { json: true, joints: false };
pub(crate) const TEXT: Wanted = Wanted { json: false, joints: false };

pub(crate) fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../config").join(name)
}

pub(crate) fn write(folder: &TempDir, text: &str) -> PathBuf {
    let path = folder.path().join("robot.toml");
    fs::write(&path, text).expect("the temporary folder is writable");
    path
}
