//! The output of every `--json` matches `docs/schema`.
//!
//! The tests of `frame` check the objects of `frame decode`.

use crate::line::Line;
use crate::programs::{commands, help, program};
use motord_harness::daemon::{self, Daemon};
use serde_json::Value;
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use tempfile::TempDir;

/// An additional motor, which has indicators.
const HAND: &str = r#"
[[motor]]
name = "hand"
bus = "desk"
id = 2
protocol = "gim"
model = "GIM8108-8"
"#;

fn config() -> String {
    format!("{}{HAND}", daemon::BENCH)
}

fn assert_valid(name: &str, line: &str) -> Value {
    assert_lines_valid(name, line);
    serde_json::from_str(line).unwrap()
}

#[test]
fn schemas_are_valid_and_belong_to_commands() {
    let known: BTreeSet<String> = ["motorctl", "motord"]
        .iter()
        .flat_map(|name| {
            commands(name).into_iter().map(|command| [&[(*name).to_owned()], &command[..]].concat().join("-"))
        })
        .collect();
    for entry in std::fs::read_dir(schemas()).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "json") {
            let name = path.file_stem().unwrap().to_str().unwrap();
            assert!(known.contains(name), "{name} is no command");
            assert!(jsonschema::meta::is_valid(&schema(name)), "{name}");
        }
    }
}

/// A command that prints JSON and has no schema is not documented.
#[test]
fn every_command_with_json_has_a_schema() {
    for name in ["motorctl", "motord"] {
        for command in commands(name) {
            let words = [&[name.to_owned()], &command[..]].concat().join("-");
            // This command prints the lines of `status`.
            let is_documented =
                words == "motorctl-watch" || schemas().join(format!("{words}.json")).is_file();
            let has_json = help(name, &command).lines().any(|line| line.trim_start().starts_with("--json"));
            assert!(is_documented || !has_json, "docs/schema/{words}.json is missing");
        }
    }
}

#[test]
fn daemon_commands_print_what_schemas_state() {
    let daemon = Daemon::start(&config());
    let printed = |arguments: &str| {
        let arguments: Vec<&str> = arguments.split(' ').collect();
        String::from_utf8(daemon.motorctl(&arguments).stdout).unwrap()
    };
    let assert_status = |status: &Value| assert_lines_valid("motorctl-status", &status.to_string());
    assert_status(&daemon.await_status(|status| status["joints"][1]["indicators"].is_object()));
    assert!(daemon.motorctl(&["estop"]).status.success());
    let stopped = daemon.await_status(|status| status["groups"][0]["stop"].is_object());
    assert_status(&stopped);
    assert_eq!(stopped["groups"][0]["stop"]["cause"], "emergency-stop");
    assert_valid("motorctl-health", &printed("health --seconds 0.1 --json"));
    assert_valid("motorctl-instances", &printed("instances --json"));
    assert_valid("motorctl-latency", &printed("latency --json"));
    let intervals = printed("latency --watch --json --interval 0.2 --seconds 0.5");
    assert_lines_valid("motorctl-latency", &intervals);
    assert!(intervals.lines().count() >= 2, "{intervals}");
    let directory = TempDir::new().unwrap();
    let recording = format!("record {}/run.mcap --seconds 0.2 --json", directory.path().display());
    assert_valid("motorctl-record", &printed(&recording));
    assert_valid("motorctl-fault", &printed("fault --json"));
    assert_valid("motorctl-sim", &printed("sim arm fault over-voltage --json"));
    assert_valid("motorctl-sim", &printed("sim arm ok --json"));

    let mut watch = daemon.command(&["watch", "--json"]).stdout(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(watch.stdout.take().unwrap()).read_line(&mut line).unwrap();
    watch.kill().unwrap();
    watch.wait().unwrap();
    assert_valid("motorctl-status", &line);
}

#[test]
fn the_doctor_prints_what_its_schema_says() {
    let output = program("motorctl").args(["doctor", "--seconds", "0.2", "--json"]).output().unwrap();
    assert_valid("motorctl-doctor", &String::from_utf8(output.stdout).unwrap());
}

#[test]
fn the_demo_prints_what_its_schema_says() {
    let output = program("motorctl").args(["demo", "--seconds", "2", "--json"]).output().unwrap();
    // The result depends on the machine.
    assert_valid("motorctl-demo", String::from_utf8(output.stdout).unwrap().lines().last().unwrap());
}

#[test]
fn bus_commands_print_what_schemas_state() {
    let (directory, line) = (TempDir::new().unwrap(), Line::knee());
    let device = line.device();
    let config = format!(
        "[[bus]]\nname = 'line'\ntype = 'serial'\ndevice = '{device}'\nevery = 5\n[[motor]]\nname = 'fl-knee'\n\
         bus = 'line'\nid = 3\nhost-id = 0x43\nprotocol = 'gim'\nmodel = 'GIM8108-8'\n"
    );
    std::fs::write(directory.path().join("line.toml"), config).unwrap();
    let run = |arguments: String| {
        let mut command = program("motorctl");
        command.current_dir(&directory).env("MOTORD_RUNTIME_DIR", directory.path());
        let output = command.args(arguments.split_whitespace()).output().unwrap();
        (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
    };
    let motor = format!("--bus {device} --id 3");
    let (text, complaint) = run(format!("config dump knee.toml {motor}"));
    assert!(directory.path().join("knee.toml").is_file(), "{text}{complaint}");
    let dumped = std::fs::read_to_string(directory.path().join("knee.toml")).unwrap();
    let other = dumped.replace("over-voltage = ", "over-voltage = 1");
    assert_ne!(other, dumped, "a difference to be shown");
    std::fs::write(directory.path().join("other.toml"), other).unwrap();
    for (name, arguments) in [
        ("scan", format!("--bus {device} --ids 1-4")),
        ("ping", motor.clone()),
        ("id", motor.clone()),
        ("version", motor.clone()),
        ("fault-get", motor.clone()),
        ("indicator", motor.clone()),
        ("parameter-get", motor.clone()),
        ("config-get", format!("torque-constant {motor}")),
        ("config-list", motor.clone()),
        ("config-diff", format!("other.toml {motor}")),
        ("setup", "--config line.toml".to_owned()),
    ] {
        let (text, complaint) = run(format!("{} {arguments} --json", name.replace('-', " ")));
        assert!(!text.is_empty(), "{name}: {complaint}");
        let printed = assert_valid(&format!("motorctl-{name}"), &text);
        assert!(!printed.as_array().is_some_and(Vec::is_empty), "{name}: {text}");
    }
}

#[test]
fn check_output_matches_schema_when_sound_or_refused() {
    let directory = TempDir::new().unwrap();
    let serial = config()
        .replace("[[bus]]", "[[imu]]\nname = 'base'\ntype = 'xsens'\ndevice = '/dev/ttyUSB1'\n[[bus]]\nname = 'line'\ntype = 'serial'\ndevice = '/dev/ttyUSB0'\n[[bus]]");
    let too_fast = config().replace("rate-hz = 100", "rate-hz = 4000");
    for (config, is_sound) in
        [(serial.as_str(), true), (&config(), true), (&too_fast, false), ("rate = 1", false)]
    {
        let path = directory.path().join("motord.toml");
        std::fs::write(&path, config).unwrap();
        let mut command = program("motord");
        let output = command.args(["check", "--json", "--joints", "--config"]).arg(&path).output().unwrap();
        let printed = assert_valid("motord-check", &String::from_utf8(output.stdout).unwrap());
        assert_eq!(printed["errors"].as_array().unwrap().is_empty(), is_sound, "{printed}");
        assert_eq!(printed["joints"].is_array(), is_sound, "{printed}");
        assert_eq!(printed["buses"].as_array().unwrap().is_empty(), config == "rate = 1", "{printed}");
    }
}

// The schemas of `docs/schema`. They permit additions of later versions; this closes them.

pub(crate) fn schemas() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/schema")
}

/// Forbids members that the schema does not describe.
fn close(schema: &mut Value) {
    match schema {
        Value::Object(members) => {
            members.values_mut().for_each(close);
            if members.contains_key("properties") {
                members.entry("additionalProperties").or_insert(false.into());
            }
        }
        Value::Array(members) => members.iter_mut().for_each(close),
        _ => {}
    }
}

/// The closed schema of a command.
pub(crate) fn schema(name: &str) -> Value {
    let path = schemas().join(format!("{name}.json"));
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut schema = serde_json::from_str(&text).unwrap();
    close(&mut schema);
    schema
}

/// Every line is an object of the command.
pub(crate) fn assert_lines_valid(name: &str, lines: &str) {
    let validator = jsonschema::validator_for(&schema(name)).unwrap();
    for line in lines.lines() {
        let printed: Value =
            serde_json::from_str(line).unwrap_or_else(|error| panic!("{name}: {error}: {line}"));
        let errors: Vec<String> = validator
            .iter_errors(&printed)
            .map(|error| format!("{}: {error}", error.instance_path()))
            .collect();
        assert!(errors.is_empty(), "{name}: {errors:#?} in {line}");
    }
}
