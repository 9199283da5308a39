//! Messages and exit statuses of `motorctl` when no daemon runs.

use crate::programs::program;
use crate::text;
use motord_harness::daemon::{BENCH, Daemon};
use serde_json::Value;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::process::{Command, Output};
use tempfile::TempDir;

/// The daily commands, with complete arguments.
const COMMANDS: [&[&str]; 12] = [
    &["demo"],
    &["monitor"],
    &["status"],
    &["watch"],
    &["latency"],
    &["enable", "legs"],
    &["disable", "legs"],
    &["reset", "legs"],
    &["estop"],
    &["release", "legs", "--force"],
    &["fault", "clear", "fl-knee"],
    &["zero", "fl-knee", "--yes"],
];

/// The commands that use the wire.
const ON_A_BUS: [&str; 24] = [
    "scan",
    "ping",
    "id",
    "version",
    "fault get",
    "start",
    "stop",
    "torque",
    "speed",
    "position",
    "jog",
    "indicator",
    "parameter get",
    "parameter set",
    "config get",
    "config list",
    "config set",
    "config dump",
    "config diff",
    "config apply",
    "config reset",
    "protocol",
    "calibrate",
    "firmware-mode",
];

/// Runs motorctl in an empty runtime directory.
fn motorctl(arguments: &[&str]) -> Output {
    let runtime = TempDir::new().unwrap();
    // No instance of another test has this name: `estop` would stop it.
    let instance = if arguments == ["estop"] { ["--instance", "nobody"].as_slice() } else { &[] };
    let mut command = Command::new(env!("CARGO_BIN_EXE_motorctl"));
    command
        .args(instance)
        .args(arguments)
        .env("MOTORD_RUNTIME_DIR", runtime.path())
        .env_remove("MOTORD_INSTANCE");
    command.output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

#[test]
fn every_command_has_help_with_an_example() {
    for command in COMMANDS {
        let name = command.iter().take(if command[0] == "fault" { 2 } else { 1 });
        assert_has_example(&name.copied().collect::<Vec<_>>());
    }
    for command in ON_A_BUS {
        assert_has_example(&command.split(' ').collect::<Vec<_>>());
    }
}

fn assert_has_example(command: &[&str]) {
    let arguments: Vec<&str> = command.iter().copied().chain(["--help"]).collect();
    let output = motorctl(&arguments);
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{arguments:?}");
    assert!(text.contains(&format!("motorctl {}", command.join(" "))), "{arguments:?}: {text}");
}

#[test]
fn bus_commands_without_motor_explain_the_option() {
    for command in ON_A_BUS.into_iter().filter(|command| !["scan", "firmware-mode"].contains(command)) {
        let complete = match command {
            "torque" | "speed" | "position" => format!("{command} 0.1 --seconds 1"),
            "jog" => "jog --seconds 1".to_owned(),
            "parameter set" | "config set" => {
                format!("{command} {} 1", if command.starts_with('p') { "0" } else { "can-id" })
            }
            "config get" => "config get can-id".to_owned(),
            "config diff" | "config apply" => format!("{command} Cargo.toml"),
            "protocol" => "protocol gim".to_owned(),
            "calibrate" => "calibrate phase".to_owned(),
            command => command.to_owned(),
        };
        let arguments: Vec<&str> = complete.split(' ').collect();
        let output = motorctl(&arguments);
        let expected =
            if command.starts_with("config diff") || command.starts_with("config apply") { 65 } else { 64 };
        assert_eq!(output.status.code(), Some(expected), "{complete}: {}", stderr(&output));
    }
}

#[test]
fn help_lists_public_commands_only() {
    let text = String::from_utf8(motorctl(&["--help"]).stdout).unwrap();
    for command in COMMANDS {
        assert!(text.contains(&format!("\n  {}", command[0])), "{}", command[0]);
    }
    assert!(!text.contains("child-guard") && !text.contains("demo-controller"));
}

#[test]
fn a_wrong_call_is_a_usage_error() {
    let wrong: [&[&str]; 7] = [
        &[],
        &["dance"],
        &["status", "--colour"],
        &["demo", "--seconds", "0"],
        &["demo", "--seconds", "NaN"],
        &["watch", "--hz", "1000000"],
        &["release", "legs"],
    ];
    for arguments in wrong {
        let output = motorctl(arguments);
        assert_eq!(output.status.code(), Some(64), "{arguments:?}: {}", stderr(&output));
        assert!(output.stdout.is_empty() && !output.stderr.is_empty(), "{arguments:?}");
    }
}

#[test]
fn commands_without_daemon_say_how_to_start_one() {
    for arguments in COMMANDS.iter().filter(|command| command[0] != "demo") {
        let output = motorctl(arguments);
        assert_eq!(output.status.code(), Some(69), "{arguments:?}: {}", stderr(&output));
        let text = stderr(&output);
        let alarm = "motorctl: EMERGENCY STOP NOT CONFIRMED: cut the power\n";
        let begin = if arguments[0] == "estop" { alarm } else { "" };
        let name = if arguments[0] == "estop" { "nobody" } else { "robot" };
        let reason = format!("{begin}motorctl: no motord runs instance \"{name}\"");
        assert!(text.starts_with(&reason), "{arguments:?}: {text}");
        assert!(text.contains("motord run"), "{arguments:?}: {text}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
    }
}

#[test]
fn instance_is_named_by_option_or_environment() {
    assert!(stderr(&motorctl(&["--instance", "arm", "status"])).contains("\"arm\""));
    assert!(stderr(&motorctl(&["status", "--instance", "arm"])).contains("\"arm\""));
    let mut command = Command::new(env!("CARGO_BIN_EXE_motorctl"));
    let runtime = TempDir::new().unwrap();
    command.arg("status").env("MOTORD_RUNTIME_DIR", runtime.path()).env("MOTORD_INSTANCE", "leg");
    assert!(stderr(&command.output().unwrap()).contains("\"leg\""));
}

#[test]
fn a_hostile_instance_name_is_a_usage_error() {
    for name in ["", "../robot", "ROBOT", "a/b", &"x".repeat(33)] {
        let output = motorctl(&["--instance", name, "status"]);
        assert_eq!(output.status.code(), Some(64), "{name:?}: {}", stderr(&output));
    }
}

#[test]
fn closed_pipeline_is_no_failure() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_motorctl"))
        .arg("--help")
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
}

#[test]
fn misplaced_group_names_the_command_that_is_meant() {
    for (command, meant) in [
        ("stop", "`motorctl disable legs` stops a group, `motorctl estop`"),
        ("start", "`motorctl enable legs`"),
    ] {
        let output = motorctl(&[command, "legs"]);
        assert_eq!(output.status.code(), Some(64), "{output:?}");
        assert!(String::from_utf8_lossy(&output.stderr).contains(meant), "{output:?}");
    }
}

#[test]
fn unknown_page_suggests_near_names() {
    for (name, near) in [
        ("motr-lost", "`motor-lost`"),
        ("Motor_Lost", "`motor-lost`"),
        ("setpoint-timout", "`setpoint-timeout`"),
    ] {
        let output = motorctl(&["explain", name]);
        let printed = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(64), "{printed}");
        assert!(
            printed.contains(&format!("there is no page {name}: did you mean ")) && printed.contains(near),
            "{printed}"
        );
    }
    let printed = motorctl(&["explain", "xyzzy"]).stderr;
    assert_eq!(
        String::from_utf8_lossy(&printed),
        "motorctl: there is no page xyzzy: `motorctl explain` lists all names\n"
    );
}

#[test]
fn fleet_becomes_the_program_with_a_network() {
    let folder = TempDir::new().unwrap();
    let fleet = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_motorctl"));
        command.args(["fleet", "stop", "--all"]).env("PATH", folder.path()).output().unwrap()
    };
    let missing = fleet();
    assert_eq!(missing.status.code(), Some(69));
    assert!(stderr(&missing).contains("package motord-remote"), "{missing:?}");
    let program = folder.path().join("motord-remote");
    std::fs::write(&program, "#!/bin/sh\necho \"$@\"\nexit 3\n").unwrap();
    std::fs::set_permissions(&program, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    let passed = fleet();
    assert_eq!((passed.status.code(), passed.stdout.as_slice()), (Some(3), &b"fleet stop --all\n"[..]));
}

// `motorctl doctor` as called by scripts. Its assessment of the test machine is not checked.

fn doctor(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_motorctl")).arg("doctor").args(arguments).output().unwrap()
}

#[test]
fn exit_status_is_verdict_and_findings_have_reasons() {
    let output = doctor(&["--seconds", "0.2", "--json"]);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let is_bad = report["verdict"] == "bad";
    assert_eq!(output.status.code(), Some(i32::from(is_bad)));
    assert!(output.stderr.is_empty(), "{output:?}");
    let findings = report["findings"].as_array().unwrap();
    assert!(
        findings.iter().all(|finding| (finding["level"] == "good") == finding["why"].is_null()),
        "{report}"
    );
    // Either the latency was measured, or the daemon of another test prevented that.
    assert!(report["wake"]["wake_latency_us"]["count"].is_u64() != report["daemon"].is_u64(), "{report}");
}

#[test]
fn refused_configuration_is_finding_and_checks_continue() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("motord.toml");
    std::fs::write(&file, "[cycle]\nrate-hz = 0\n").unwrap();
    let output = doctor(&["--seconds", "0", "--config", file.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("rate-hz") && text.contains("$ motord check --config '"), "{text}");
    assert!(text.contains("kernel") && text.ends_with("verdict: bad\n"), "{text}");
}

#[test]
fn time_out_of_range_is_usage_error() {
    for seconds in ["-1", "nan", "1e9"] {
        assert_eq!(doctor(&[&format!("--seconds={seconds}")]).status.code(), Some(64), "{seconds}");
    }
}

// Arguments and environment variables that are not UTF-8.

/// A letter of ISO 8859-1, and no UTF-8.
fn latin() -> &'static OsStr {
    OsStr::from_bytes(b"caf\xe9")
}

/// Checks that a program ended with a sentence.
fn assert_is_refused(line: &str, output: &Output) {
    let printed = text(&[&output.stdout[..], &output.stderr].concat());
    assert!(!printed.contains("panicked") && !printed.is_empty(), "{line}: {printed}");
    assert!(output.status.code().is_some_and(|status| (64..=80).contains(&status)), "{line}: {output:?}");
}

fn output(program: &mut Command) -> Output {
    let empty = TempDir::new().unwrap();
    program.env_remove("MOTORD_INSTANCE").env("MOTORD_RUNTIME_DIR", empty.path()).output().unwrap()
}

#[test]
fn argument_that_is_not_utf8_is_error() {
    for (name, lines) in [
        (
            "motord",
            &["", "check", "run", "run --plant", "deadman", "safe-stop", "--log", "init --file x --legs"][..],
        ),
        (
            "motorctl",
            &["", "status", "--instance", "explain", "frame decode", "sim", "plot", "replay", "latency"],
        ),
        ("motord-sim", &["", "--config", "--seed"]),
    ] {
        for line in lines {
            let mut command = program(name);
            command.args(line.split_whitespace()).arg(latin());
            assert_is_refused(&format!("{name} {line}"), &output(&mut command));
        }
    }
}

#[test]
fn variable_that_is_not_utf8_is_error() {
    for (name, line, variable) in
        [("motorctl", "status", "MOTORD_INSTANCE"), ("motord", "check x.toml", "MOTORD_LOG")]
    {
        let mut command = program(name);
        command.args(line.split(' ')).env_remove("MOTORD_INSTANCE").env(variable, latin());
        assert_is_refused(name, &command.output().unwrap());
    }
}

#[test]
fn text_that_is_not_utf8_costs_no_stop() {
    let daemon = Daemon::start(BENCH);
    let stopped_by = |command: &mut Command| {
        daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
        let output = command.output().unwrap();
        assert!(output.status.success(), "{command:?}: {output:?}");
        assert!(text(&output.stderr).contains("UTF-8") || text(&output.stderr).contains("unexpected"));
        assert_eq!(daemon.status()["emergency_stop"], true, "{command:?}");
        assert!(daemon.motorctl(&["reset", "--wait"]).status.success());
    };
    stopped_by(daemon.command(&["estop"]).arg(latin()));
    stopped_by(daemon.command(&["e-stop", "--config"]).arg(latin()));
    stopped_by(daemon.command(&["estop"]).env("MOTORD_INSTANCE", latin()).arg(latin()));
}

#[test]
fn mistyped_stop_beside_latin_names_the_command() {
    let output = output(program("motorctl").arg("stop").arg(latin()));
    assert_eq!(output.status.code(), Some(64), "{output:?}");
    assert!(text(&output.stderr).ends_with("NOTHING WAS STOPPED: type `motorctl estop`\n"), "{output:?}");
}
