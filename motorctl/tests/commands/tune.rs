//! `motorctl tune`: steps of a joint whose simulated mechanics are in its configuration.

use crate::schemas::assert_lines_valid;
use crate::{assert_free, started, text};
use motord_harness::daemon::{Daemon, bench_at, until};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use std::f64::consts::TAU;
use std::process::Stdio;

/// Inertia of the joint: 0.00384 kg·m² are the rotor behind its gear.
const INERTIA: f64 = 0.03;
const VISCOUS: f64 = 0.08;
const JOINT: &str = "\
limits = { position-rad = [-0.8, 0.8], velocity-rad-s = 6.0 }
[motor.simulation]
load-inertia-kg-m2 = 0.02616
viscous-friction-nm-s-per-rad = 0.08
coulomb-friction-nm = 0.1
";

fn robot(rate_hz: u32, protocol: &str) -> String {
    let robot = bench_at(rate_hz).replace("[safety]", "max-skipped-percent = 100\n[safety]");
    robot.replace("protocol = \"mit\"", &format!("protocol = \"{protocol}\"")) + JOINT
}

fn tuned(daemon: &Daemon, options: &[&str]) -> Value {
    let output = daemon.motorctl(&[&["tune", "arm", "--yes", "--json"], options].concat());
    let printed = text(&output.stdout);
    assert!(output.status.success(), "{printed}{}", text(&output.stderr));
    assert_lines_valid("motorctl-tune", &printed);
    println!("{printed}");
    serde_json::from_str(&printed).unwrap()
}

#[track_caller]
fn assert_near(value: &Value, wanted: f64, share: f64) {
    let found = value.as_f64().unwrap_or(f64::NAN);
    assert!((found - wanted).abs() <= share * wanted, "{found} is not {wanted}");
}

/// No setpoint was sent: the group was never claimed.
fn assert_unmoved(daemon: &Daemon) {
    assert_free(daemon);
    let status = daemon.status();
    assert_eq!(status["groups"][0]["accepted"], 0, "{status}");
}

#[test]
fn proposal_suits_joint_and_calms_its_steps() {
    let daemon = started(&robot(500, "mit"));
    let picture = daemon.directory.path().join("tune.svg");
    let gains = ["--kp", "30", "--kd", "0.3", "--bandwidth", "8", "--seconds", "0.6", "--try"];
    let found = tuned(&daemon, &[&gains[..], &["--svg", picture.to_str().unwrap()]].concat());
    let omega = TAU * 8.0;
    let (proposed, before, after) = (&found["proposed"], &found["before"], &found["after"]);
    assert_near(&proposed["kp"], INERTIA * omega * omega, 0.06);
    assert_near(&proposed["kd"], 2.0 * INERTIA * omega - VISCOUS, 0.08);
    assert_eq!((&found["loop"], &proposed["bound"]), (&"drive".into(), &Value::Null));
    assert!(before["overshoot_percent"].as_f64().unwrap() > 15.0, "{before}");
    assert!(after["overshoot_percent"].as_f64().unwrap() < 6.0, "{after}");
    // Critical damping: the rise takes 3.36/omega.
    assert_near(&after["rise_ms"], 3.36e3 / omega, 0.25);
    let drawn = std::fs::read_to_string(picture).unwrap();
    for word in ["before: kp 30.0, kd 0.30", "proposed: kp", "angle since the step, rad", "N·m"] {
        assert!(drawn.contains(word), "{word}");
    }
    assert_free(&daemon);
}

/// A native motor is stiff by way of the bus: each torque answers a state of the turn before.
#[test]
fn slow_native_joint_gets_lower_bandwidth() {
    let daemon = started(&robot(200, "gim"));
    assert!(daemon.motorctl(&["sim", "arm", "delayed", "2ms"]).status.success());
    let found = tuned(&daemon, &["--bandwidth", "20", "--seconds", "0.6"]);
    let proposed = &found["proposed"];
    assert_eq!((&found["loop"], &proposed["bound"]), (&"cycle".into(), &"delay".into()));
    // One and a half turns of 5 ms.
    assert!(found["delay_ms"].as_f64().unwrap() >= 7.4, "{found}");
    assert!((4.0..6.5).contains(&proposed["bandwidth_hz"].as_f64().unwrap()), "{proposed}");
    assert!(proposed["phase_margin_deg"].as_f64().unwrap() >= 45.0, "{proposed}");
    // Half the bandwidth is a quarter of the stiffness.
    let [before, full] = [&found["before"], proposed].map(|of| of["kp"].as_f64().unwrap());
    assert!(before < 0.6 * full, "{before} is not half of {full}");
    let notes = found["notes"].to_string();
    assert!(notes.contains("Hz instead of 20.0 Hz") && notes.contains("phase margin below 45°"), "{notes}");
    assert_free(&daemon);
}

#[test]
fn steps_that_do_not_fit_move_nothing() {
    let daemon = started(&robot(100, "mit"));
    let refused = |options: &[&str], complaint: &str| {
        let output = daemon.motorctl(&[&["tune", "arm", "--yes"], options].concat());
        assert_eq!(output.status.code(), Some(64), "{output:?}");
        assert!(text(&output.stderr).contains(complaint), "{}", text(&output.stderr));
        assert_unmoved(&daemon);
    };
    refused(&["--step-rad", "0.5"], "its limits are -0.80 to 0.80 rad: choose --step-rad 0.400 or less");
    refused(&["--step-rad", "0.3", "--kp", "90", "--kd", "1"], "kp 90.0 times the step is 27.00 N·m");
    refused(&["--step-rad", "2"], "expected 0.005 to 0.5");
    refused(&["--kp", "20"], "--kd");
    refused(&["--json", "--svg", "-"], "--json and the picture exclude each other");
    let unconfirmed = daemon.motorctl(&["tune", "arm"]);
    let warning = text(&unconfirmed.stderr);
    assert!(
        warning.contains("This moves arm by setpoints of ±0.30 rad for 14 s, then in steps of ±0.05 rad"),
        "{warning}"
    );
    assert_unmoved(&daemon);
}

/// Writes the output of an identification that found this inertia, kg·m².
fn identified(daemon: &Daemon, inertia: f64) -> String {
    let file = daemon.directory.path().join("arm.json");
    let entry = |value: f64| format!(r#"{{ "value": {value}, "is_identified": true }}"#);
    let [inertia, viscous] = [inertia, VISCOUS].map(entry);
    let known = format!(
        r#"{{ "joint": "arm", "inertia_kg_m2": {inertia}, "viscous_friction_nm_s_per_rad": {viscous} }}"#
    );
    std::fs::write(&file, known).unwrap();
    file.to_str().unwrap().to_owned()
}

#[test]
fn given_gains_without_margin_move_nothing() {
    let daemon = started(&robot(100, "gim"));
    let file = identified(&daemon, INERTIA);
    let options = ["tune", "arm", "--yes", "--kp", "60", "--kd", "0.5", "--identified", &file];
    let output = daemon.motorctl(&options);
    assert_eq!(output.status.code(), Some(64), "{output:?}");
    assert!(text(&output.stderr).contains("kp 60.0 and kd 0.50 leave a phase margin of -"), "{output:?}");
    assert_unmoved(&daemon);
}

/// The file has ten times the inertia: gains that suit it make the joint oscillate.
#[test]
fn joint_that_oscillates_is_damped_and_named() {
    let free = robot(100, "gim").replace("velocity-rad-s = 6.0", "velocity-rad-s = 30.0");
    let daemon = started(&free);
    let file = identified(&daemon, 10.0 * INERTIA);
    let gains = ["--kp", "18", "--kd", "4.6", "--identified", &file];
    let output = daemon.motorctl(&[&["tune", "arm", "--yes"], &gains[..]].concat());
    let complaint = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{complaint}");
    assert!(complaint.contains("arm is not tuned: it "), "{complaint}");
    assert!(complaint.contains("Its group is stopped"), "{complaint}");
    assert_free(&daemon);
}

#[test]
fn interrupted_tuning_ends_stopped_with_130() {
    let daemon = started(&robot(100, "mit"));
    let mut command = daemon.command(&["tune", "arm", "--yes"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    until("an active group, or the end", || {
        let is_active = daemon.status()["groups"][0]["phase"] == "active";
        (is_active || child.try_wait().unwrap().is_some()).then_some(())
    });
    kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGINT).unwrap();
    let ended = child.wait_with_output().unwrap();
    let printed = text(&ended.stderr);
    assert_eq!(ended.status.code(), Some(130), "{printed}");
    assert!(printed.contains("arm is not tuned: the motion was interrupted"), "{printed}");
    assert_free(&daemon);
}
