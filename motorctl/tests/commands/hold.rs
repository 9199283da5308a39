//! `motorctl hold`: the first motion, through a daemon with simulated motors.

use crate::schemas::assert_lines_valid;
use crate::{assert_free, started, text};
use motord_client::{Client, State};
use motord_harness::daemon::{BENCH, Daemon, slow_quadruped};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use std::process::{Child, Output, Stdio};
use std::time::{Duration, Instant};

const TIMEOUT: Duration = Duration::from_secs(20);

/// Starts `motorctl hold` with these arguments, and waits until its group is active.
fn holding(daemon: &Daemon, arguments: &[&str]) -> Child {
    let mut command = daemon.command(&[&["hold"], arguments].concat());
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    daemon.await_status(|status| status["groups"][0]["phase"] == "active");
    child
}

fn interrupted(child: Child) -> Output {
    kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGINT).unwrap();
    child.wait_with_output().unwrap()
}

/// Waits until a state is as wanted.
fn await_state(client: &Client, wanted: impl Fn(&State) -> bool) {
    let deadline = Instant::now() + TIMEOUT;
    while !wanted(&client.wait(TIMEOUT).unwrap()) {
        assert!(Instant::now() < deadline, "the state does not come");
    }
}

#[test]
fn hold_keeps_position_and_ends_stopped() {
    let daemon = started(BENCH);
    let held = daemon.motorctl(&["hold", "arm", "--seconds", "1.5", "--hz", "10", "--json"]);
    assert!(held.status.success(), "{}", text(&held.stderr));
    let lines = text(&held.stdout);
    assert_lines_valid("motorctl-hold", &lines);
    let lines: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!((5..=15).contains(&lines.len()), "{lines:?}");
    for line in &lines {
        let position = line["joints"][0]["position_rad"].as_f64().unwrap();
        let goal = line["joints"][0]["goal_rad"].as_f64().unwrap();
        assert!((position - goal).abs() < 0.02, "{line}");
        assert_eq!((&line["joints"][0]["name"], &line["group"]), (&"arm".into(), &"all".into()));
    }
    assert_free(&daemon);
}

#[test]
fn sine_moves_joint_by_its_amplitude() {
    let daemon = started(BENCH);
    let sine = ["hold", "--kp", "40", "--amplitude-rad", "0.2", "--frequency-hz", "0.5", "--seconds", "4"];
    let moved = daemon.motorctl(&sine);
    let printed = text(&moved.stdout);
    assert!(moved.status.success(), "{printed}{}", text(&moved.stderr));
    assert!(
        printed.starts_with("holds the 1 joint of all with kp 40, kd 0.5, ±0.2 rad at 0.5 Hz. Ctrl-C"),
        "{printed}"
    );
    let row = printed.lines().find(|line| line.starts_with("arm ")).unwrap();
    let cells: Vec<f64> = row.split_whitespace().skip(1).map(|cell| cell.parse().unwrap()).collect();
    let [first, _, lowest, highest, _] = cells[..] else { panic!("{row}") };
    assert!((0.1..0.25).contains(&(first - lowest)) && (0.1..0.25).contains(&(highest - first)), "{row}");
    assert!(printed.ends_with("all: stopped, after damping what moves\n"), "{printed}");
}

#[test]
fn interrupt_damps_and_stops_the_motors() {
    let daemon = started(BENCH);
    let ended = interrupted(holding(&daemon, &[]));
    assert!(ended.status.success(), "{}", text(&ended.stderr));
    assert!(
        text(&ended.stdout).ends_with("all: stopped, after damping what moves\n"),
        "{}",
        text(&ended.stdout)
    );
    assert_free(&daemon);
}

#[test]
fn gains_rise_within_limits_and_others_are_damped() {
    let daemon = Daemon::start(&slow_quadruped());
    daemon.await_status(|status| {
        status["joints"].as_array().is_some_and(|joints| joints.iter().all(|joint| joint["mode"] == "idle"))
    });
    let client = Client::connect_in(daemon.directory.path(), "demo").unwrap();
    let (knee, hip) = (client.joint_named("fl-knee").unwrap(), client.joint_named("rr-hip").unwrap());
    let most = client.description().joints[knee].limits.kp;
    let child = holding(&daemon, &["fl-knee", "--kp", "500", "--kd", "0.7"]);
    await_state(&client, |state| {
        let [knee, hip] = [knee, hip].map(|joint| state.joint(joint).unwrap().applied);
        assert!(knee.kp <= most && hip.kp == 0.0, "{knee:?} {hip:?}");
        knee.kp > 0.9 * most && hip.kd > 0.5
    });
    let ended = interrupted(child);
    let printed = text(&ended.stdout);
    assert!(
        printed
            .starts_with("holds fl-knee with kp 500, kd 0.7; the other 11 joints of legs are only damped."),
        "{printed}"
    );
    assert!(
        printed.contains(&format!("fl-knee: the configuration limits the gains to kp {most}, kd 0.7")),
        "{printed}"
    );
}

#[test]
fn stopped_group_is_refused_with_cause_and_commands() {
    let daemon = started(BENCH);
    let child = holding(&daemon, &[]);
    assert!(daemon.motorctl(&["estop"]).status.success());
    let during = child.wait_with_output().unwrap();
    let refused = daemon.motorctl(&["hold"]);
    for output in [during, refused] {
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        let complaint = text(&output.stderr);
        assert!(
            complaint.contains("all was stopped for emergency-stop: An emergency stop was requested."),
            "{complaint}"
        );
        assert!(
            complaint.contains("Then run `motorctl --instance bench reset all`, and this command again"),
            "{complaint}"
        );
    }
    let status = daemon.await_status(|status| status["groups"][0]["phase"] == "disarmed");
    assert_eq!(status["groups"][0]["stop"]["cause"], "emergency-stop", "the stop stays latched");
    assert!(daemon.motorctl(&["reset", "--wait"]).status.success());
    assert!(daemon.motorctl(&["hold", "--seconds", "0.2"]).status.success());
}

#[test]
fn group_of_another_process_is_refused() {
    let daemon = started(BENCH);
    let child = holding(&daemon, &[]);
    let refused = daemon.motorctl(&["hold", "arm"]);
    assert_eq!(refused.status.code(), Some(1));
    let owner =
        format!("all belongs to another process (pid {}, motorctl): end that program first", child.id());
    assert!(text(&refused.stderr).contains(&owner), "{}", text(&refused.stderr));
    assert!(interrupted(child).status.success(), "the owner goes on until it is interrupted");
}

#[test]
fn unfit_joint_is_refused_before_any_motion() {
    let daemon =
        Daemon::start(&BENCH.replace("[[motor]]", "[[motor]]\nlimits = { position-rad = [-0.1, 0.1] }"));
    daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
    let refused = |arguments: &[&str], status: i32, complaint: &str| {
        let output = daemon.motorctl(&[&["hold"], arguments].concat());
        assert_eq!(output.status.code(), Some(status), "{output:?}");
        assert!(text(&output.stderr).contains(complaint), "{}", text(&output.stderr));
        assert_eq!(text(&output.stdout), "");
        assert_free(&daemon);
    };
    refused(&["leg"], 64, "there is no joint or group leg. The groups are all; the joints are arm");
    refused(&["arm", "--amplitude-rad", "0.2"], 64, "with ±0.2 rad it would leave its limits, -0.10 to 0.10");
    refused(&["--amplitude-rad", "2"], 64, "expected 0 to 0.5");
    refused(&["--kp", "NaN"], 64, "expected 0 to 500");
    assert!(daemon.motorctl(&["exclude", "arm"]).status.success());
    refused(
        &["arm"],
        1,
        "arm is excluded, so its motor receives only stop frames: `motorctl --instance bench include arm`",
    );
    assert!(daemon.motorctl(&["include", "arm"]).status.success());
    assert!(daemon.motorctl(&["sim", "arm", "off"]).status.success());
    daemon.await_status(|status| status["joints"][0]["mode"] == "offline");
    refused(&["arm"], 69, "joint arm has not reported its position: check that its motor has power");
}

/// Goal: the loop that moves the robot never waits for the reader of its output.
#[test]
fn reader_that_pauses_does_not_stop_robot() {
    let daemon = Daemon::start(&slow_quadruped());
    daemon.await_status(|status| {
        status["joints"].as_array().is_some_and(|joints| joints.iter().all(|joint| joint["mode"] == "idle"))
    });
    let child = holding(&daemon, &["--json", "--hz", "100"]);
    std::thread::sleep(Duration::from_secs(4));
    let status = daemon.status();
    let group = &status["groups"][0];
    assert_eq!((&group["phase"], &group["stop"]), (&"active".into(), &Value::Null));
    assert!(interrupted(child).status.success());
}

#[test]
fn refused_hold_claims_to_hold_nothing() {
    let daemon = started(BENCH);
    assert!(daemon.motorctl(&["sim", "arm", "fault", "over-voltage"]).status.success());
    daemon.await_status(|status| status["joints"][0]["mode"] == "fault");
    let refused = daemon.motorctl(&["hold"]);
    assert!(!refused.status.success(), "{refused:?}");
    assert_eq!(text(&refused.stdout), "", "{refused:?}");
}
