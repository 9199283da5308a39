//! `motorctl identify`: a joint of a running daemon whose simulated mechanics are in its
//! configuration.

use crate::schemas::assert_lines_valid;
use crate::{assert_free, started, text};
use motord_client::Client;
use motord_harness::daemon::{Daemon, bench_at, until};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use std::process::{Child, Stdio};

/// A motor with an inertia of 0.03 kg·m², of which 0.00384 are the rotor behind its gear.
const HIDDEN: &str = r#"
limits = { position-rad = [-1.0, 1.0], velocity-rad-s = 6.0 }

[motor.simulation]
load-inertia-kg-m2 = 0.02616
viscous-friction-nm-s-per-rad = 0.08
coulomb-friction-nm = 0.25
reply-latency-us = 120
"#;

fn hidden() -> String {
    bench_at(500).replace("[safety]", "max-skipped-percent = 100\n[safety]") + HIDDEN.trim_start()
}

/// The value, and whether `truth` is in the interval or at most `share` away.
fn assert_near(printed: &Value, truth: f64, share: f64) {
    let number = |key: &str| printed[key].as_f64().unwrap_or(f64::NAN);
    let is_near = (number("value") - truth).abs() <= share * truth;
    let is_inside = (number("lower")..=number("upper")).contains(&truth);
    assert_eq!(printed["is_identified"], true, "{printed}");
    assert!(is_near || is_inside, "{printed} is not {truth}");
}

#[test]
fn joint_is_identified_and_its_lines_are_read() {
    let daemon = started(&hidden());
    let file = daemon.directory.path().join("arm.toml");
    let arguments =
        ["identify", "arm", "--seconds", "16", "--yes", "--json", "--output", file.to_str().unwrap()];
    let found = daemon.motorctl(&arguments);
    let printed = text(&found.stdout);
    assert!(found.status.success(), "{printed}{}", text(&found.stderr));
    assert_lines_valid("motorctl-identify", &printed);
    let printed: Value = serde_json::from_str(&printed).unwrap();
    println!("{printed:#}");
    assert_near(&printed["inertia_kg_m2"], 0.03, 0.02);
    assert_near(&printed["viscous_friction_nm_s_per_rad"], 0.08, 0.1);
    assert_near(&printed["coulomb_friction_nm"], 0.25, 0.05);
    assert_near(&printed["reply_latency_us"], 120.0, 0.4);
    assert_free(&daemon);

    // The configuration without its mechanics and with the lines is one, and they are known again.
    let lines = std::fs::read_to_string(&file).unwrap();
    let hidden = hidden();
    let (motor, _) = hidden.split_once("[motor.simulation]").unwrap();
    drop(daemon);
    let again = Daemon::start(&format!("{motor}{lines}"));
    again.await_status(|status| status["joints"][0]["mode"] == "idle");
    assert!(
        lines.contains("load-inertia-kg-m2 = 0.026") || lines.contains("load-inertia-kg-m2 = 0.025"),
        "{lines}"
    );
}

#[test]
fn interrupted_identification_ends_stopped_with_130() {
    let daemon = started(&hidden());
    let mut child = identifying(&daemon);
    let client = Client::connect_in(daemon.directory.path(), "bench").unwrap();
    let mut moving = 0;
    while moving < 50 && child.try_wait().unwrap().is_none() {
        let state = client.wait(std::time::Duration::from_secs(20)).unwrap();
        moving += u32::from(state.joint(0).and_then(|joint| joint.velocity()).is_some_and(|v| v.abs() > 0.1));
    }
    kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGINT).unwrap();
    let ended = child.wait_with_output().unwrap();
    let printed = text(&ended.stderr);
    assert_eq!(ended.status.code(), Some(130), "{printed}");
    assert!(printed.contains("arm is not identified: the motion was interrupted"), "{printed}");
    assert_free(&daemon);
}

#[test]
fn stopped_group_ends_identification_with_its_cause() {
    let daemon = started(&hidden());
    let mut child = identifying(&daemon);
    await_active(&daemon, &mut child);
    assert!(daemon.motorctl(&["estop"]).status.success());
    let ended = child.wait_with_output().unwrap();
    let printed = text(&ended.stderr);
    assert_eq!(ended.status.code(), Some(1), "{printed}");
    assert!(printed.contains("emergency-stop") && printed.contains("reset all"), "{printed}");
}

/// The daemon has stopped the group before: that the program could not stop it explains nothing.
#[test]
fn removed_owner_is_told_so() {
    let daemon = started(&hidden());
    let mut child = identifying(&daemon);
    await_active(&daemon, &mut child);
    assert!(daemon.motorctl(&["release", "all", "--force"]).status.success());
    let ended = child.wait_with_output().unwrap();
    let printed = text(&ended.stderr);
    assert!(!ended.status.success() && printed.contains("was taken from its owner"), "{printed}");
}

/// A program that moves the joint.
fn identifying(daemon: &Daemon) -> Child {
    let mut command = daemon.command(&["identify", "arm", "--yes"]);
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Waits until the group is active, or the program has ended.
fn await_active(daemon: &Daemon, child: &mut Child) {
    until("an active group, or the end", || {
        let is_active = daemon.status()["groups"][0]["phase"] == "active";
        (is_active || child.try_wait().unwrap().is_some()).then_some(())
    });
}

#[test]
fn unconfirmed_or_narrow_motion_moves_nothing() {
    let daemon = started(&hidden());
    let refused = |arguments: &[&str]| {
        let output = daemon.motorctl(&[&["identify", "arm"], arguments].concat());
        assert!(!output.status.success());
        text(&output.stderr)
    };
    let unconfirmed = refused(&[]);
    assert!(unconfirmed.contains("This moves arm by ±0.30 rad for 42 s"), "{unconfirmed}");
    let wide = refused(&["--amplitude-rad", "1.5", "--yes"]);
    assert!(
        wide.contains("arm is not identified: it is at 0.00 rad, where its limits, -1.00 to 1.00"),
        "{wide}"
    );
    let alone = refused(&["--known-load", "0.5@0.2", "--yes"]);
    assert!(alone.contains("--without"), "{alone}");
    assert_free(&daemon);
}
