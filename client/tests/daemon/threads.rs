//! Clients that several threads share.

use super::fake_daemon::Running;
use super::{TIMEOUT, connect, directory, until};
use motord_client::{Claim, Client, Error, Setpoint};
use std::sync::atomic::Ordering;
use std::time::Duration;
use tempfile::TempDir;

/// Threads may share a client, and move a claim to another thread.
const _: () = {
    const fn must_be_shared_by_threads<T: Send + Sync>() {}
    must_be_shared_by_threads::<Client>();
    must_be_shared_by_threads::<Claim>();
};

/// A daemon that serves but publishes nothing, a client that has read its last state, and the
/// client's claim.
fn silent_daemon(directory: &TempDir) -> (Running, Client, Claim) {
    let daemon = Running::start(directory.path(), 1);
    let client = connect(directory);
    client.set_silence(4 * TIMEOUT);
    let claim = client.claim("leg").unwrap();
    daemon.silent.store(true, Ordering::Relaxed);
    until("the last state", || client.wait(Duration::from_millis(50)).is_err().then_some(()));
    (daemon, client, claim)
}

const STOPS: u64 = 5;

/// Stops the robot of a daemon that publishes nothing: whether the motors answer is not known.
fn is_confirmed(client: &Client) -> bool {
    matches!(client.emergency_stop(), Err(Error::MotorsUnchecked { .. }))
}

/// Goal: a thread that waits for a state does not block a setpoint or an emergency stop of another
/// thread.
///
/// Method: the daemon serves but publishes nothing, so one thread sleeps in `wait` until the others
/// are done.
#[test]
fn waiting_thread_blocks_neither_send_nor_stop() {
    let directory = directory();
    let (daemon, client, mut claim) = silent_daemon(&directory);
    std::thread::scope(|scope| {
        let waiting = scope.spawn(|| client.wait(3 * TIMEOUT));
        std::thread::sleep(Duration::from_millis(50));
        for _ in 0..STOPS {
            claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
            assert!(is_confirmed(&client));
        }
        until("the setpoints", || daemon.setpoints().last().filter(|last| last.sequence == STOPS).copied());
        assert!(!waiting.is_finished(), "there was no state yet");
        daemon.silent.store(false, Ordering::Relaxed);
        waiting.join().unwrap().unwrap();
    });
}

#[test]
fn spinning_thread_blocks_neither_send_nor_stop() {
    let directory = directory();
    let (daemon, client, mut claim) = silent_daemon(&directory);
    std::thread::scope(|scope| {
        let spinning = scope.spawn(|| client.spin(3 * TIMEOUT));
        for _ in 0..STOPS {
            claim.send(&[Setpoint::damping(1.0); 2]).unwrap();
            assert!(is_confirmed(&client));
        }
        assert!(!spinning.is_finished(), "there was no state yet");
        daemon.silent.store(false, Ordering::Relaxed);
        spinning.join().unwrap().unwrap();
    });
}

#[test]
fn pending_request_blocks_no_emergency_stop() {
    let directory = directory();
    let _daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    client.wait(TIMEOUT).unwrap();
    std::thread::scope(|scope| {
        let asking = scope.spawn(|| client.clear_fault("hip"));
        std::thread::sleep(Duration::from_millis(50));
        client.emergency_stop().unwrap();
        assert!(!asking.is_finished(), "it waits for its answer for a second");
        assert!(matches!(asking.join().unwrap(), Err(Error::NoAnswer { .. })));
    });
}

/// Goal: each state is returned to one thread, and a sleeping thread does not delay another.
#[test]
fn two_threads_that_wait_share_the_states() {
    let directory = directory();
    let daemon = Running::start(directory.path(), 1);
    let client = connect(&directory);
    client.set_silence(4 * TIMEOUT);
    let cycles = || (0..100).map(|_| client.wait(TIMEOUT).unwrap().cycle()).collect::<Vec<_>>();
    let mut seen = std::thread::scope(|scope| {
        let (one, other) = (scope.spawn(cycles), scope.spawn(cycles));
        [one.join().unwrap(), other.join().unwrap()].concat()
    });
    seen.sort_unstable();
    assert!(seen.windows(2).all(|pair| pair[0] < pair[1]), "no state is given twice");
    daemon.silent.store(true, Ordering::Relaxed);
    until("the last state", || client.wait(Duration::from_millis(50)).is_err().then_some(()));
    std::thread::scope(|scope| {
        let patient = scope.spawn(|| client.wait(3 * TIMEOUT));
        std::thread::sleep(Duration::from_millis(50));
        let error = client.wait(Duration::from_millis(20)).unwrap_err();
        assert!(matches!(error, Error::Timeout { .. }), "{error}");
        assert!(!patient.is_finished());
        daemon.silent.store(false, Ordering::Relaxed);
        patient.join().unwrap().unwrap();
    });
}
