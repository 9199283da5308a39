//! The daemon's side of the dead man's switch: it registers, and waits for a switch that is
//! missing, late or hangs.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use crate::deadman::{Recorder, Switch, beating, runtime, safe_frames};
use motord_bus::clock;
use motord_core::stopper::Outlet;
use motord_deadman::channel::{Answer, Listener, Request, TIMEOUT as SWITCH_TIMEOUT};
use motord_deadman::heartbeat::{Heartbeat, Pulse};
use motord_deadman::registrar::Registrar;
use motord_deadman::safe_frames::InterfaceError;
use motord_deadman::server::Server;
use motord_ports::instance::Instance;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::Duration;

/// A registrar of a daemon, in a separate thread.
pub(crate) struct Registration {
    /// Its reports: `true` when the switch is unavailable.
    pub(crate) lost: Receiver<bool>,
    end: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Registration {
    pub(crate) fn start(instance: &Instance, pulse: Pulse) -> Self {
        let (losses, lost) = channel();
        let report = move |is_lost| {
            let _ended = losses.send(is_lost);
        };
        let mut registrar = Registrar::new(instance.clone(), safe_frames(), pulse).reports(report);
        let end = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&end);
        let thread = spawn(move || registrar.run(|| ended.load(Ordering::Relaxed)));
        Self { lost, end, thread }
    }

    pub(crate) fn end(self) {
        self.end.store(true, Ordering::Relaxed);
        self.thread.join().unwrap();
    }
}

#[test]
fn daemon_finds_a_switch_that_starts_later() {
    let (_directory, instance) = runtime();
    let (heartbeat, pulse) = beating();
    let registration = Registration::start(&instance, pulse);
    let switch = Switch::start(&instance);
    assert!(switch.sent.recv_timeout(Duration::from_secs(10)).is_ok(), "this heartbeat stands still");
    heartbeat.rest();
    registration.end();
}

/// A switch may be stopped, or opens an interface while another process configures one. A daemon
/// that gives up meanwhile would look dead to it, and it would stop the motors of a robot that
/// walks.
#[test]
fn late_switch_leaves_living_daemon_alone() {
    let (_directory, instance) = runtime();
    let (heartbeat, pulse) = beating();
    let ends = Arc::new(AtomicBool::new(false));
    let ended = Arc::clone(&ends);
    let beats = spawn(move || {
        for beat in 2_u64.. {
            if ended.load(Ordering::Relaxed) {
                return heartbeat.rest();
            }
            heartbeat.beat(beat);
            sleep(Duration::from_millis(1));
        }
    });
    let (sent, sends) = channel();
    let open =
        move |_: &str, _| -> Result<Box<dyn Outlet>, InterfaceError> { Ok(Box::new(Recorder::new(&sent))) };
    let mut server = Server::new(Listener::bind(&instance).unwrap(), open);
    let registration = Registration::start(&instance, pulse);
    sleep(SWITCH_TIMEOUT + Duration::from_millis(500));
    let due = clock::monotonic() + Duration::from_secs(1);
    while clock::monotonic() < due {
        server.turn(due);
        assert!(!server.is_acting(), "the daemon lives");
    }
    ends.store(true, Ordering::Relaxed);
    beats.join().unwrap();
    registration.end();
    drop(server);
    assert_eq!(sends.iter().count(), 0);
}

#[test]
fn registrar_without_heartbeat_exits_on_request() {
    let (_directory, instance) = runtime();
    let (_heartbeat, pulse) = Heartbeat::create().unwrap();
    let Registration { end, thread, .. } = Registration::start(&instance, pulse);
    sleep(Duration::from_millis(100));
    end.store(true, Ordering::Relaxed);
    let due = clock::monotonic() + Duration::from_secs(10);
    while !thread.is_finished() {
        assert!(clock::monotonic() < due, "it waits for the heartbeat");
        sleep(Duration::from_millis(1));
    }
}

/// Goal: a robot that requires its switch logs when it is missing, hangs and reconnects.
/// Method: the switch is this thread, which answers the registration, and sends signs of life as
/// the test requires.
#[test]
fn registrar_distinguishes_absent_and_hanging_switch() {
    let (_directory, instance) = runtime();
    let (_heartbeat, pulse) = beating();
    let switch = Listener::bind(&instance).unwrap();
    let registration = Registration::start(&instance, pulse);
    let next = || registration.lost.recv_timeout(Duration::from_secs(20)).unwrap();
    assert!(next(), "away");
    let daemon = loop {
        match switch.accept() {
            Ok(daemon) => break daemon,
            Err(_) => sleep(Duration::from_millis(1)),
        }
    };
    while daemon.receive::<Request>().is_err() {
        sleep(Duration::from_millis(1));
    }
    daemon.send(&Answer::Registered, None).unwrap();
    assert!(!next(), "registered");
    assert!(next(), "it gives no sign of life");
    daemon.beat();
    assert!(!next(), "it goes on");
    assert!(next(), "and hangs again");
    drop((daemon, switch));
    assert!(next(), "and ends");
    registration.end();
}
