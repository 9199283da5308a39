//! Goal: a killed controller or daemon leaves a damped robot, and the other processes report the
//! cause immediately.
//! Method: real processes with the shipped simulated quadruped. The test checks the daemon's
//! published states, cycle by cycle, by their own times. Durations on this machine do not count.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

use crate::alone;
use motord_client::{Cause, Claim, Client, Error, Phase, Setpoint, State};
use motord_harness::daemon::{Daemon, quadruped, until};
use motord_harness::programs::Process;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Variable for the killed controller: the runtime directory of its daemon. It is this program,
/// started again for one ignored test.
const RUNTIME: &str = "MOTORD_TEST_RUNTIME";

fn controller(daemon: &Daemon) -> Process {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command
        .args(["--ignored", "--exact", "deaths::controller_process"])
        .env(RUNTIME, daemon.directory.path());
    Process(command.stdout(Stdio::null()).spawn().unwrap())
}

fn group(state: &State) -> motord_client::Group {
    state.group(0).unwrap()
}

/// Claims the legs, and sends setpoints that hold them.
fn claimed(client: &Client) -> (Claim, Vec<Setpoint>) {
    let mut claim = client.claim("legs").unwrap();
    let state = until("a state", || client.wait(Duration::from_secs(1)).ok());
    let hold: Vec<_> = state
        .joints()
        .map(|joint| Setpoint::impedance(joint.position().unwrap(), 0.0, 40.0, 1.0, 0.0))
        .collect();
    claim.send(&hold).unwrap();
    (claim, hold)
}

/// Claims, enables and holds, until it is killed.
#[test]
#[ignore = "the process that other tests kill"]
fn controller_process() {
    let Some(runtime) = std::env::var_os(RUNTIME) else { return };
    let client = Client::connect_in(Path::new(&runtime), "demo").unwrap();
    let (mut claim, hold) = claimed(&client);
    claim.enable().unwrap();
    loop {
        let _state = client.wait(Duration::from_secs(1)).unwrap();
        claim.send(&hold).unwrap();
    }
}

#[test]
fn killed_controller_leaves_joints_damped_until_reset() {
    let _alone = alone();
    let daemon = Daemon::start(&quadruped());
    let client = daemon.connect();
    let mut controller = controller(&daemon);
    until("motion", || {
        let state = client.wait(Duration::from_secs(1)).unwrap();
        let stiff = state.joints().all(|joint| joint.applied.kp > 39.0);
        (stiff && group(&state).phase == Some(Phase::Active)).then_some(())
    });
    controller.0.kill().unwrap();

    let damped = until("damping", || {
        let state = client.wait(Duration::from_secs(1)).unwrap();
        (group(&state).phase == Some(Phase::Damping)).then_some(state)
    });
    assert!(
        damped.joints().all(|joint| joint.applied.kp == 0.0 && joint.applied.kd > 0.0),
        "every joint is damped"
    );
    assert_eq!(group(&damped).cause, Some(Cause::OwnerDied), "its death tells, not its silence");

    until("rest", || {
        let state = client.wait(Duration::from_secs(1)).unwrap();
        (group(&state).phase == Some(Phase::Disarmed)).then_some(())
    });
    let (mut claim, hold) = claimed(&client);
    let refused = claim.enable().unwrap_err();
    assert!(matches!(refused, Error::Refused { .. }), "{refused}");
    claim.reset().unwrap();
    claim.send(&hold).unwrap();
    claim.enable().unwrap();
}

#[test]
fn killed_daemon_is_error_and_successor_is_found() {
    let _alone = alone();
    let mut daemon = Daemon::start(&quadruped());
    let client = daemon.connect();
    let killed = Instant::now();
    daemon.process.kill().unwrap();
    let error = until("an error", || client.wait(Duration::from_secs(5)).err());
    println!("{:?} after the kill: {error}", killed.elapsed());
    assert!(matches!(error, Error::NotRunning { .. } | Error::Silent { .. }), "{error}");
    daemon.process.wait().unwrap();

    daemon.restart();
    let message = until("the restart", || match client.wait(Duration::from_secs(1)) {
        Err(error @ Error::Restarted) => Some(error.to_string()),
        Ok(_) | Err(_) => None,
    });
    assert!(!message.is_empty());
    until("states of the successor", || client.wait(Duration::from_secs(1)).ok());
}

/// Goal: a program that starts after the death learns of the death, and not of a frozen daemon.
/// Method: the test does not wait for the killed process, so its id still exists.
#[test]
fn killed_daemon_is_dead_to_new_client() {
    let _alone = alone();
    let mut daemon = Daemon::start(&quadruped());
    drop(daemon.connect());
    daemon.process.kill().unwrap();
    std::thread::sleep(Duration::from_millis(500));
    let begun = Instant::now();
    let error = Client::connect_in(daemon.directory.path(), "demo").unwrap_err();
    println!("after {:?}: {error}", begun.elapsed());
    assert!(matches!(error, Error::NotRunning { .. }), "{error}");
    daemon.process.wait().unwrap();
}
