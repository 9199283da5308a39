//! Emergency stops of motors that do not answer.

use super::fake_daemon::Running;
use super::{INSTANCE, connect, directory};
use motord_client::{Error, emergency_stop_in};
use std::sync::atomic::Ordering;
use std::time::Duration;

#[test]
fn stop_with_silent_motor_is_no_success() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let stops = || [client.emergency_stop(), emergency_stop_in(directory.path(), INSTANCE)];
    assert_eq!(stops(), [Ok(()), Ok(())]);
    daemon.mute.store(true, Ordering::Relaxed);
    for outcome in stops() {
        let error = outcome.unwrap_err();
        assert_eq!(error, Error::MotorsOffline { joints: vec!["knee".into()] });
        assert!(error.to_string().ends_with("so cut the power: knee"), "{error}");
        assert_eq!((error.exit_status(), error.is_transient()), (80, false));
    }
    daemon.excluded.store(true, Ordering::Relaxed);
    assert_eq!(stops(), [Ok(()), Ok(())], "an excluded motor needs no answer");
}

#[test]
fn stop_without_states_is_no_success() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    daemon.silent.store(true, Ordering::Relaxed);
    std::thread::sleep(Duration::from_millis(50));
    for outcome in [client.emergency_stop(), emergency_stop_in(directory.path(), INSTANCE)] {
        assert!(matches!(outcome, Err(Error::MotorsUnchecked { .. })), "{outcome:?}");
    }
}

/// A loop in another thread must get the state that it waits for.
#[test]
fn check_of_answers_leaves_states_to_loops() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let before = client.newest().unwrap().map_or(0, |state| state.cycle());
    assert_eq!(client.offline_joints(None, Duration::from_secs(5)), Ok(vec![]));
    daemon.silent.store(true, Ordering::Relaxed);
    std::thread::sleep(Duration::from_millis(50));
    // It reads the last state, and does not take it.
    assert!(client.offline_joints(Some("leg"), Duration::from_millis(1)).is_err());
    assert!(client.newest().unwrap().is_some_and(|state| state.cycle() > before));
}
