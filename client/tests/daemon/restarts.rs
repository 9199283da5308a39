//! Daemons and clients that stall, restart or are killed.

use super::fake_daemon::{Running, granted};
use super::{INSTANCE, TIMEOUT, connect, directory, spawn, until};
use motord_client::{Client, Error, InstanceError, Refusal, Setpoint, State};
use motord_ports::Instance;
use motord_shared::limits::CONTROLLERS_MAX;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Returns how often this thread has slept.
fn sleeps() -> u64 {
    let status = std::fs::read_to_string("/proc/thread-self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("voluntary_ctxt_switches")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
fn slow_controller_sleeps_through_other_states() {
    const N: u32 = 20;
    let directory = directory();
    let _daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let first = client.wait_cycles(N, TIMEOUT).unwrap().cycle();
    let (mut last, before) = (first, sleeps());
    for _ in 0..20 {
        let cycle = client.wait_cycles(N, TIMEOUT).unwrap().cycle();
        assert!(cycle / u64::from(N) > last / u64::from(N), "{cycle} follows {last}");
        last = cycle;
    }
    let slept = sleeps() - before;
    assert!(slept < (last - first) / 2, "{slept} sleeps in {} cycles", last - first);
}

#[test]
fn slow_controller_notices_restart_and_silence() {
    hears_of_a_restart_and_of_silence(|client| client.wait_cycles(2, TIMEOUT));
}

#[test]
fn spinning_controller_notices_restart_and_silence() {
    hears_of_a_restart_and_of_silence(|client| client.spin(TIMEOUT));
}

/// Goal: a client never concludes from the id of a process in another namespace that no motord
/// runs.
#[test]
fn silent_daemon_in_container_is_not_dead() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    client.wait(TIMEOUT).unwrap();
    daemon.silent.store(true, Ordering::Relaxed);
    let error = until("silence", || client.wait(TIMEOUT).err());
    assert!(matches!(error, Error::Silent { .. }), "{error}");
}

fn hears_of_a_restart_and_of_silence(take: fn(&Client) -> Result<State, Error>) {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    take(&client).unwrap();
    daemon.silent.store(true, Ordering::Relaxed);
    let error = until("silence", || take(&client).err());
    assert!(matches!(error, Error::Silent { .. }), "{error}");
    drop(daemon);
    let _successor = Running::start(directory.path(), 2);
    until("the restart", || (take(&client) == Err(Error::Restarted)).then_some(()));
    take(&client).unwrap();
}

#[test]
fn a_restart_is_told_once_and_survived() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = client.claim("leg").unwrap();
    client.wait(TIMEOUT).unwrap();
    drop(daemon);
    let daemon = Running::start(directory.path(), 2);
    let error = until("the restart", || match client.wait(TIMEOUT) {
        Ok(_) | Err(Error::Silent { .. } | Error::Timeout { .. }) => None,
        Err(error) => Some(error),
    });
    assert_eq!(error, Error::Restarted);
    client.wait(TIMEOUT).unwrap();
    assert_eq!(client.description().boot_id, 2);
    for _ in 0..3 {
        assert_eq!(
            claim.send(&[Setpoint::damping(1.0); 2]),
            Err(Error::Restarted),
            "a void claim stays void"
        );
    }
    assert_eq!(claim.enable(), Err(Error::Restarted));
    assert_eq!(daemon.setpoints(), []);
    let mut claim = client.claim("leg").unwrap();
    claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
    until("the setpoint", || {
        daemon.setpoints().first().filter(|first| first.lease == granted(2, 1)).copied()
    });
}

/// Five cycles of the successor last longer than the silence that the caller has set.
#[test]
fn configured_silence_outlives_a_slower_daemon() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = Client::connect_in(directory.path(), INSTANCE).unwrap();
    client.set_silence(Duration::from_millis(200));
    client.wait(TIMEOUT).unwrap();
    drop(daemon);
    let daemon = Running::start_with(directory.path(), 2, 2, 0.1);
    until("the restart", || matches!(client.wait(TIMEOUT), Err(Error::Restarted)).then_some(()));
    client.wait(TIMEOUT).unwrap();
    daemon.silent.store(true, Ordering::Relaxed);
    assert!(matches!(until("an error", || client.wait(TIMEOUT).err()), Error::Silent { .. }));
}

#[test]
fn request_after_restart_reports_it_and_acts_not() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    client.wait(TIMEOUT).unwrap();
    drop(daemon);
    let _successor = Running::start(directory.path(), 2);
    until("the restart", || matches!(client.enable("leg"), Err(Error::Restarted)).then_some(()));
    assert!(matches!(client.enable("leg"), Err(Error::Refused { refusal: Refusal::NoSetpoint, .. })));
}

#[test]
fn silent_daemon_is_reported_within_few_silence_times() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    let mut claim = client.claim("leg").unwrap();
    client.wait(TIMEOUT).unwrap();
    daemon.silent.store(true, Ordering::Relaxed);
    let begun = Instant::now();
    let error = until("an error", || client.wait(TIMEOUT).err());
    assert!(
        matches!(error, Error::Silent { .. }),
        "it holds its lock, so its states are merely silent: {error}"
    );
    assert!(begun.elapsed() < TIMEOUT, "waiting ends when the silence is noticed, not when its time is over");
    assert!(claim.send(&[Setpoint::damping(1.0); 2]).is_err());
}

#[test]
fn killed_daemon_is_noticed_and_successor_found() {
    let directory = directory();
    let mut daemon = spawn("killed_daemon", &directory, 1);
    let client = until("a daemon", || Client::connect_in(directory.path(), INSTANCE).ok());
    client.set_silence(Duration::from_millis(500));
    client.wait(TIMEOUT).unwrap();
    daemon.kill().unwrap();
    daemon.wait().unwrap();
    let error = until("an error", || client.wait(TIMEOUT).err());
    assert!(matches!(error, Error::NotRunning { .. }), "{error}");
    let mut daemon = spawn("killed_daemon", &directory, 2);
    let error = until("the restart", || match client.wait(TIMEOUT) {
        Err(Error::NotRunning { .. } | Error::Timeout { .. }) => None,
        other => Some(other),
    });
    assert_eq!(error.unwrap_err(), Error::Restarted);
    assert!(client.wait(TIMEOUT).is_ok());
    client.claim("leg").unwrap().release().unwrap();
    daemon.kill().unwrap();
    daemon.wait().unwrap();
}

/// Goal: a killed process blocks no other process, and its slots become free.
///
/// Method: kill more processes in sequence than there are slots for controllers.
#[test]
fn killed_controllers_neither_block_nor_keep_slots() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    for _ in 0..=CONTROLLERS_MAX {
        let before = daemon.setpoints().len();
        let mut controller = spawn("killed_controller", &directory, 0);
        until("setpoints", || (daemon.setpoints().len() > before).then_some(()));
        controller.kill().unwrap();
        controller.wait().unwrap();
        client.wait(TIMEOUT).unwrap();
        client.emergency_stop().unwrap();
        client.force_release("leg").unwrap();
    }
    client.claim("leg").unwrap().send(&[Setpoint::damping(1.0); 2]).unwrap();
}

#[test]
fn second_daemon_learns_who_runs_the_instance() {
    let directory = directory();
    let instance = Instance::below(directory.path(), INSTANCE).unwrap();
    let lock = instance.lock().unwrap();
    let error = instance.lock().unwrap_err();
    assert!(
        matches!(error, InstanceError::AlreadyRunning { pid, .. } if pid == std::process::id()),
        "{error}"
    );
    Instance::below(directory.path(), "other").unwrap().lock().unwrap();
    drop(lock);
    instance.lock().unwrap();
}
