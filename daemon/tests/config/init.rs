//! `motord init`: every configuration that it writes is valid, and it overwrites nothing.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use crate::mistakes::implausible;
use motord_configuration as config;
use nix::pty::openpty;
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

fn init(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_motord"));
    command.arg("init").args(arguments).stdin(Stdio::null()).output().unwrap()
}

fn written(file: &Path, arguments: &[&str]) -> config::Loaded {
    let file_name = file.to_str().unwrap();
    let output = init(&[arguments, &["--file", file_name]].concat());
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    config::load(file).unwrap_or_else(|error| panic!("{arguments:?}: {error}"))
}

#[test]
fn every_configuration_that_is_written_passes_check() {
    let directory = tempfile::tempdir().unwrap();
    let models = ["GIM8108-8", "GIM3505-8", "GIM10015-9", "DM-J4310-2EC", "RS00"];
    for legs in 1..=8 {
        for (index, model) in models.into_iter().enumerate() {
            let file = directory.path().join(format!("{legs}-{index}.toml"));
            let legs = legs.to_string();
            let loaded = written(&file, &["--legs", &legs, "--model", model, "--simulated"]);
            assert_eq!(loaded.settings.motors.len(), 3 * legs.parse::<usize>().unwrap());
            assert_eq!(implausible(&loaded.warnings), [""; 0]);
        }
    }
}

/// A simulated robot runs on any machine; a robot with motors keeps the default times.
#[test]
fn only_simulated_robots_get_wide_times() {
    let directory = tempfile::tempdir().unwrap();
    let shipped = config::load(&crate::document::shipped("quadruped-simulated.toml")).unwrap().settings;
    let written = |name: &str, bus: &[&str]| {
        let file = directory.path().join(name);
        written(&file, &[&["--legs", "1", "--model", "GIM8108-8"], bus].concat()).settings
    };
    let simulated = written("simulated.toml", &["--simulated"]);
    assert_eq!(simulated.cycle.max_lateness, shipped.cycle.max_lateness);
    assert_eq!(format!("{:?}", simulated.safety), format!("{:?}", shipped.safety));
    let real = written("real.toml", &["--buses", "can0"]);
    assert_eq!(real.cycle.max_lateness, Duration::from_millis(5));
    assert_eq!(real.safety.setpoint_timeout, Duration::from_millis(20));
}

#[test]
fn init_rate_is_highest_the_buses_allow() {
    let directory = tempfile::tempdir().unwrap();
    for (buses, rate_hz) in [("can0,can1,can2,can3", 1000.0), ("can0,can1", 500.0), ("can0", 250.0)] {
        let file = directory.path().join(format!("{rate_hz}.toml"));
        let loaded = written(&file, &["--legs", "4", "--buses", buses, "--yes"]);
        assert_eq!(loaded.settings.cycle.rate_hz, rate_hz, "{buses}");
    }
    let output = init(&["--legs", "4", "--buses", "can0", "--rate-hz", "1000", "--yes"]);
    assert_eq!(output.status.code(), Some(78));
    let complaint = String::from_utf8(output.stderr).unwrap();
    assert!(complaint.contains("later than the reply deadline"), "{complaint}");
}

/// Two adapters with exchanged names must find no motor that obeys them.
#[test]
fn init_gives_each_motor_its_own_ids() {
    let directory = tempfile::tempdir().unwrap();
    let cases: [&[&str]; 5] = [
        &["--legs", "4", "--buses", "can0,can1,can2,can3"],
        &["--legs", "4", "--buses", "can0,can1"],
        &["--legs", "4", "--model", "DM-J4310-2EC", "--buses", "can0,can1,can2,can3"],
        &["--legs", "6", "--model", "RS00", "--buses", "can0,can1,can2,can3,can4,can5"],
        &["--legs", "2", "--protocol", "gim", "--buses", "/dev/ttyUSB0,/dev/ttyUSB1"],
    ];
    for (index, arguments) in cases.iter().enumerate() {
        let loaded =
            written(&directory.path().join(format!("{index}.toml")), &[*arguments, &["--yes"]].concat());
        let motors = &loaded.settings.motors;
        let ids: BTreeSet<_> = motors.iter().map(|motor| motor.id).collect();
        let host_ids: BTreeSet<_> = motors.iter().map(|motor| motor.host_id).collect();
        assert_eq!([ids.len(), host_ids.len()], [motors.len(); 2], "{arguments:?}");
        let warned: Vec<_> = loaded.warnings.iter().map(ToString::to_string).collect();
        assert!(
            !warned.iter().any(|warning| warning.contains("exchanged") || warning.contains("host id")),
            "{warned:?}"
        );
    }
}

#[test]
fn init_gives_line_motors_affordable_turns() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("motord.toml");
    let loaded = written(&file, &["--legs", "1", "--protocol", "gim", "--buses", "/dev/ttyUSB0", "--yes"]);
    assert_eq!(loaded.settings.motors.len(), 3);
    assert!(loaded.settings.buses[0].has_turns(), "three motors in one cycle");
}

#[test]
fn serial_bus_needs_no_protocol() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("arm.toml");
    let loaded = written(&file, &["--legs", "1", "--buses", "/dev/ttyUSB0", "--yes"]);
    assert!(loaded.settings.motors.iter().all(|motor| motor.protocol.name() == "gim"));
    assert!(fs::read_to_string(&file).unwrap().contains("\nturnaround-us = 1500\n"));
}

#[test]
fn existing_file_is_replaced_only_on_request() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("motord.toml");
    fs::write(&file, "mine").unwrap();
    let name = file.to_str().unwrap();
    let output = init(&["--yes", "--file", name]);
    assert_eq!(output.status.code(), Some(73));
    assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
    assert!(init(&["--yes", "--file", name, "--force"]).status.success());
    config::load(&file).unwrap();
}

#[test]
fn an_answer_that_cannot_be_used_is_named() {
    for (arguments, complaint) in [
        (&["--model", "GIM9999"][..], "no model is called"),
        (&["--legs", "0"], "1 to 8 legs"),
        (&["--legs", "1", "--buses", "can0,can1"], "more buses than legs"),
        (&["--joints", "Hip!"], "cannot be a name"),
        (&["--buses", "a\"/b"], "cannot be an interface"),
        (&["--model", "RS00", "--protocol", "gim"], "do not speak the protocol \"gim\""),
        (&["--rate-hz", "nan"], "cycle.rate-hz"),
    ] {
        let output = init(&[arguments, &["--yes"]].concat());
        let printed = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && printed.contains(complaint), "{arguments:?}: {printed}");
        assert!(output.stdout.is_empty(), "{arguments:?} wrote something");
    }
}

#[test]
fn terminal_prompts_with_defaults_for_empty_answers() {
    assert_eq!(answered(["2", "", "GIM6010-8", "", "simulated"]), (6, 2));
    assert_eq!(answered(["1", "", "", "", ""]), (3, 1));
    assert_eq!(answered(["6", "", "", "", ""]), (18, 6));
}

/// Motors and buses of the configuration that is written after these answers.
fn answered(answers: [&str; 5]) -> (usize, usize) {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("motord.toml");
    let terminal = openpty(None, None).unwrap();
    let near = || Stdio::from(terminal.slave.try_clone().unwrap());
    let mut command = Command::new(env!("CARGO_BIN_EXE_motord"));
    command.args(["init", "--file", file.to_str().unwrap()]).env("TERM", "xterm");
    let mut asked = command.stdin(near()).stdout(Stdio::null()).stderr(near()).spawn().unwrap();
    drop(terminal.slave);
    let mut master = File::from(terminal.master);
    // Legs, joints, model, protocol, buses.
    for answer in answers {
        wait_for(&mut master, ": ");
        master.write_all(format!("{answer}\r").as_bytes()).unwrap();
        wait_for(&mut master, "\n");
    }
    assert!(asked.wait().unwrap().success());
    let loaded = config::load(&file).unwrap();
    (loaded.settings.motors.len(), loaded.settings.buses.len())
}

/// Goal: `motord init` on a terminal writes a file, and overwrites none without asking.
/// Method: a terminal on all three streams, twice in one directory; then the same into a pipe.
#[test]
fn terminal_without_file_asks_for_one() {
    let directory = tempfile::tempdir().unwrap();
    let complete = ["init", "--legs", "1", "--model", "GIM8108-8", "--simulated"];
    let on_terminal = |answers: &[(&str, &str)]| {
        let terminal = openpty(None, None).unwrap();
        let near = || Stdio::from(terminal.slave.try_clone().unwrap());
        let mut command = Command::new(env!("CARGO_BIN_EXE_motord"));
        command.args(complete).env("TERM", "xterm").current_dir(directory.path());
        let mut asked = command.stdin(near()).stdout(near()).stderr(near()).spawn().unwrap();
        drop(command);
        drop(terminal.slave);
        let mut master = File::from(terminal.master);
        for (question, answer) in answers {
            wait_for(&mut master, question);
            master.write_all(format!("{answer}\r").as_bytes()).unwrap();
        }
        let mut rest = Vec::new();
        let _end_of_terminal = master.read_to_end(&mut rest);
        assert!(asked.wait().unwrap().success(), "{}", String::from_utf8_lossy(&rest));
    };
    let file = |name: &str| fs::read_to_string(directory.path().join(name)).unwrap();
    on_terminal(&[("File to write", "")]);
    assert!(file("robot.toml").contains("GIM8108-8"));
    fs::write(directory.path().join("robot.toml"), "mine").unwrap();
    on_terminal(&[("File to write", ""), ("Replace it?", "n"), ("File to write", "other.toml")]);
    assert_eq!(file("robot.toml"), "mine");
    assert!(file("other.toml").contains("GIM8108-8"));
    on_terminal(&[("File to write", ""), ("Replace it?", "y")]);
    assert_eq!(file("robot.toml"), file("other.toml"));

    let terminal = openpty(None, None).unwrap();
    let mut piped = Command::new(env!("CARGO_BIN_EXE_motord"));
    let piped = piped.args(complete).stdin(Stdio::from(terminal.slave)).output().unwrap();
    assert_eq!(String::from_utf8(piped.stdout).unwrap(), file("other.toml"));
}

/// Each command with a configuration takes it with and without `--config`.
#[test]
fn configuration_needs_no_option() {
    let file = crate::document::shipped("quadruped-simulated.toml");
    let missing = Path::new("/nonexistent/robot.toml");
    let motord = |arguments: &[&str], file: &Path| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_motord"));
        command.args(arguments).arg(file).stdin(Stdio::null()).output().unwrap()
    };
    let [plain, option] = [&["check"][..], &["check", "--config"]].map(|arguments| motord(arguments, &file));
    assert!(plain.status.success() && plain.stdout == option.stdout, "{plain:?}");
    for command in ["check", "run", "deadman", "safe-stop"] {
        let output = motord(&[command], missing);
        let printed = [output.stdout, output.stderr].concat();
        let printed = String::from_utf8_lossy(&printed);
        assert_eq!(output.status.code(), Some(78), "{command}: {printed}");
        assert!(printed.contains("/nonexistent/robot.toml: cannot be read"), "{command}: {printed}");
    }
    let both = motord(&["check", "a.toml", "--config"], &file);
    assert_eq!(both.status.code(), Some(64), "one file, not two");
}

fn wait_for(terminal: &mut File, text: &str) {
    let (mut seen, mut byte) = (String::new(), [0]);
    while !seen.ends_with(text) {
        terminal.read_exact(&mut byte).unwrap();
        seen.push(char::from(byte[0]));
    }
}
