//! `motorctl health`, against running daemons with simulated motors.

use crate::{started, text};
use motord_harness::daemon::{BENCH, Daemon};
use motord_harness::programs::program;
use serde_json::Value;
use std::process::{Output, Stdio};
use tempfile::TempDir;

/// Any share of missed ticks is healthy: the machine may have other load.
const QUICK: [&str; 4] = ["--seconds", "0.2", "--missed-percent", "100"];

fn health(daemon: &Daemon, more: &[&str]) -> Output {
    daemon.motorctl(&[&["health"], &QUICK[..], more].concat())
}

/// The exit status, and the checks of the findings.
fn found(daemon: &Daemon) -> (i32, Vec<String>) {
    let output = health(daemon, &["--json"]);
    let printed: Value = serde_json::from_slice(&output.stdout).unwrap();
    let status = output.status.code().unwrap();
    assert_eq!((&printed["status"], &printed["healthy"]), (&status.into(), &(status == 0).into()));
    let findings = printed["findings"].as_array().unwrap();
    (status, findings.iter().map(|finding| finding["check"].as_str().unwrap().to_owned()).collect())
}

#[test]
fn healthy_robot_has_status_zero() {
    let daemon = started(BENCH);
    let output = health(&daemon, &[]);
    let printed = text(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{printed}{}", text(&output.stderr));
    assert!(
        printed.starts_with("bench is healthy: motord ") && printed.ends_with("ticks missed\n"),
        "{printed}"
    );
}

#[test]
fn trouble_has_its_status_and_reason() {
    let daemon = started(BENCH);
    assert!(daemon.motorctl(&["estop"]).status.success());
    let output = health(&daemon, &[]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        text(&output.stdout).contains("robot: all is stopped for emergency-stop"),
        "{}",
        text(&output.stdout)
    );
    assert_eq!(text(&output.stderr), "", "the reasons are the output");

    assert!(daemon.motorctl(&["reset"]).status.success());
    assert!(daemon.motorctl(&["sim", "arm", "off"]).status.success());
    daemon.await_status(|status| status["joints"][0]["mode"] == "offline");
    let (status, checks) = found(&daemon);
    assert!(status == 1 && checks.iter().all(|check| check == "robot"), "{checks:?}");
}

#[test]
fn changed_configuration_needs_a_restart() {
    let daemon = started(BENCH);
    std::fs::write(daemon.directory.path().join("motord.toml"), BENCH.replace("1000.0", "900.0")).unwrap();
    daemon.await_status(|status| status["config_changed"] == true);
    assert_eq!(found(&daemon), (3, vec!["configuration".to_owned()]));
}

#[test]
fn missing_daemon_has_a_finding() {
    let directory = TempDir::new().unwrap();
    let command = |more: &[&str]| {
        let mut command = program("motorctl");
        command
            .env("MOTORD_RUNTIME_DIR", directory.path())
            .args(["--instance", "bench", "health"])
            .args(more);
        command.output().unwrap()
    };
    let output = command(&["--json"]);
    let printed: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(69));
    assert_eq!((&printed["version"], &printed["findings"][0]["check"]), (&Value::Null, &"daemon".into()));
    assert!(text(&command(&[]).stdout).starts_with("daemon: "), "{}", text(&command(&[]).stdout));
}

#[test]
fn wait_ends_with_healthy_robot() {
    let daemon = started(BENCH);
    assert!(daemon.motorctl(&["estop"]).status.success());
    let waiting =
        daemon.command(&[&["health", "--wait", "60"], &QUICK[..]].concat()).stdout(Stdio::piped()).spawn();
    let waiting = waiting.unwrap();
    assert_eq!(health(&daemon, &[]).status.code(), Some(1));
    assert!(daemon.motorctl(&["reset"]).status.success());
    let output = waiting.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stdout));
}
