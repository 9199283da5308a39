//! Every `--json` prints what `docs/schema` says.
//!
//! The schemas leave room for what later versions add. Here they are closed, so that nothing is printed that they do not
//! describe.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

mod line;
mod programs;

use line::Line;
use programs::{commands, help, program};
use serde_json::Value;
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const PATIENCE: Duration = Duration::from_secs(30);

/// Slow, so that it runs beside other tests.
const CONFIG: &str = r#"
[daemon]
instance = "bench"
[cycle]
rate-hz = 100
max-lateness-ms = 1000.0
[safety]
setpoint-timeout-ms = 1000.0
deadman-ms = 2000.0
[[bus]]
name = "desk"
type = "simulated"
[[motor]]
name = "arm"
bus = "desk"
id = 1
protocol = "mit"
model = "GIM8108-8"
[[motor]]
name = "hand"
bus = "desk"
id = 2
protocol = "gim"
model = "GIM8108-8"
"#;

fn schemas() -> PathBuf {
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
fn schema(name: &str) -> Value {
    let path = schemas().join(format!("{name}.json"));
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut schema = serde_json::from_str(&text).unwrap();
    close(&mut schema);
    schema
}

fn assert_valid(name: &str, line: &str) -> Value {
    let printed: Value = serde_json::from_str(line).unwrap_or_else(|error| panic!("{name}: {error}: {line}"));
    let validator = jsonschema::validator_for(&schema(name)).unwrap();
    let errors: Vec<String> =
        validator.iter_errors(&printed).map(|error| format!("{}: {error}", error.instance_path())).collect();
    assert!(errors.is_empty(), "{name}: {errors:#?} in {line}");
    printed
}

/// A daemon, and a directory for it.
struct Daemon {
    process: Child,
    directory: TempDir,
}

impl Daemon {
    fn start() -> Self {
        let directory = TempDir::new().unwrap();
        std::fs::write(directory.path().join("motord.toml"), CONFIG).unwrap();
        let mut command = program("motord");
        command.arg("run").arg("--config").arg(directory.path().join("motord.toml"));
        let process =
            command.env("MOTORD_RUNTIME_DIR", directory.path()).stderr(Stdio::null()).spawn().unwrap();
        Self { process, directory }
    }

    fn motorctl(&self, arguments: &str) -> Command {
        let mut command = program("motorctl");
        command.env("MOTORD_RUNTIME_DIR", self.directory.path()).args(["--instance", "bench"]);
        command.args(arguments.split_whitespace());
        command
    }

    fn printed(&self, arguments: &str) -> String {
        String::from_utf8(self.motorctl(arguments).output().unwrap().stdout).unwrap()
    }

    /// Asks for the status until it is as it should be.
    fn await_status(&self, is_so: impl Fn(&Value) -> bool) -> String {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let line = self.printed("status --json");
            if serde_json::from_str(&line).is_ok_and(|status| is_so(&status)) {
                return line;
            }
            assert!(Instant::now() < deadline, "{line}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _gone = self.process.kill();
        let _status = self.process.wait();
    }
}

#[test]
fn the_schemas_are_schemas_and_each_belongs_to_a_command() {
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
            // It prints the lines of `status`.
            let is_documented =
                words == "motorctl-watch" || schemas().join(format!("{words}.json")).is_file();
            let has_json = help(name, &command).lines().any(|line| line.trim_start().starts_with("--json"));
            assert!(is_documented || !has_json, "docs/schema/{words}.json is missing");
        }
    }
}

#[test]
fn the_commands_that_ask_the_daemon_print_what_their_schemas_say() {
    let daemon = Daemon::start();
    let is_heard = |status: &Value| status["joints"][1]["indicators"].is_object();
    assert_valid("motorctl-status", &daemon.await_status(is_heard));
    assert!(daemon.motorctl("estop").output().unwrap().status.success());
    let is_stopped = |status: &Value| status["groups"][0]["stop"].is_object();
    let stopped = assert_valid("motorctl-status", &daemon.await_status(is_stopped));
    assert_eq!(stopped["groups"][0]["stop"]["cause"], "emergency-stop");
    assert_valid("motorctl-instances", &daemon.printed("instances --json"));
    assert_valid("motorctl-latency", &daemon.printed("latency --json"));
    assert_valid("motorctl-fault", &daemon.printed("fault --json"));

    let mut watch = daemon.motorctl("watch --json").stdout(Stdio::piped()).spawn().unwrap();
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
    // Whether it passes depends on the machine.
    assert_valid("motorctl-demo", String::from_utf8(output.stdout).unwrap().lines().last().unwrap());
}

#[test]
fn the_commands_on_the_wire_print_what_their_schemas_say() {
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
    let (said, complaint) = run(format!("config dump knee.toml {motor}"));
    assert!(directory.path().join("knee.toml").is_file(), "{said}{complaint}");
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
        let (said, complaint) = run(format!("{} {arguments} --json", name.replace('-', " ")));
        assert!(!said.is_empty(), "{name}: {complaint}");
        let printed = assert_valid(&format!("motorctl-{name}"), &said);
        assert!(!printed.as_array().is_some_and(Vec::is_empty), "{name}: {said}");
    }
}

#[test]
fn check_prints_what_its_schema_says_of_a_sound_and_of_a_refused_configuration() {
    let directory = TempDir::new().unwrap();
    let serial = CONFIG
        .replace("[[bus]]", "[[bus]]\nname = 'line'\ntype = 'serial'\ndevice = '/dev/ttyUSB0'\n[[bus]]");
    let too_fast = CONFIG.replace("rate-hz = 100", "rate-hz = 4000");
    for (config, is_sound) in
        [(serial.as_str(), true), (CONFIG, true), (&too_fast, false), ("rate = 1", false)]
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
