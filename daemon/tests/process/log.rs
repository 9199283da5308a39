//! The log of one session, in the form of the journal.
#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

use motord_client::{Client, Error};
use motord_harness::daemon::{Daemon, TIMEOUT, bench_at, log_path, until};
use motord_ports::injection::inject;
use motord_ports::{ClientPorts, Instance};
use motord_shared::message::{ALL_GROUPS, JOINT_VALID};
use motord_shared::{
    AdminRequest, JointSetpoint, MotorMode, Operation, Phase, SetpointMessage, StateMessage,
};
use std::io::Read;
use std::os::fd::AsFd;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A motor `elbow` in the group `arm`. The joint is at rest, so the damping is short.
fn config(rate_hz: u32) -> String {
    bench_at(rate_hz).replace("\"arm\"", "\"elbow\"") + "[[group]]\nname = \"arm\"\njoints = [\"elbow\"]\n"
}

/// Starts a daemon whose standard error may be the journal's stream.
fn start(for_journal: bool) -> Daemon {
    let directory = TempDir::new().unwrap();
    let log = log_path(&directory);
    Daemon::start_in(directory, &config(200), |command| {
        let stream = nix::sys::stat::stat(&log).unwrap();
        if for_journal {
            command.env("JOURNAL_STREAM", format!("{}:{}", stream.st_dev, stream.st_ino));
        }
    })
}

fn instance(daemon: &Daemon) -> Instance {
    Instance::below(daemon.directory.path(), "bench").unwrap()
}

/// Ends the daemon, and returns the lines of its log.
fn end(mut daemon: Daemon) -> Vec<String> {
    assert!(daemon.end().success());
    daemon.log().lines().map(str::to_owned).collect()
}

/// A client of the session.
struct Requester {
    ports: ClientPorts,
    state: StateMessage,
}

impl Requester {
    fn of(instance: &Instance) -> Self {
        let begun = Instant::now();
        loop {
            let ports = instance.attach().ok().flatten().map(ClientPorts::open);
            if let Some(Ok(ports)) = ports {
                return Self { ports, state: StateMessage::default() };
            }
            assert!(begun.elapsed() < TIMEOUT, "no daemon");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    fn ask(&self, operation: Operation, lease: u64) -> (u64, u32) {
        let group = if operation == Operation::EmergencyStop { ALL_GROUPS } else { 0 };
        let request = AdminRequest {
            lease,
            group,
            operation: operation.code(),
            pid: std::process::id(),
            ..Default::default()
        };
        let (begun, question) = (Instant::now(), self.ports.ask(request).unwrap());
        loop {
            if let Some((reply, _)) = question.answer().unwrap() {
                return (reply.lease, reply.refusal);
            }
            assert!(begun.elapsed() < TIMEOUT, "no answer to {operation}");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn until(&mut self, wanted: impl Fn(&StateMessage) -> bool) {
        let begun = Instant::now();
        while !wanted(&self.state) {
            assert!(begun.elapsed() < TIMEOUT, "{:?} {:?}", self.state.groups[0], self.state.joints[0]);
            if let Some(state) = self.ports.newest_state().unwrap() {
                self.state = state;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Claims the arm, enables it, and holds it until it is active.
    fn activate(&mut self) {
        self.until(|state| state.joints[0].flags & JOINT_VALID != 0);
        let (lease, _) = self.ask(Operation::Claim, 0);
        let port = self.ports.setpoint_port().unwrap();
        let (begun, mut sequence, mut enabled) = (Instant::now(), 0, false);
        while self.state.groups[0].phase != Phase::Active.code() {
            assert!(begun.elapsed() < TIMEOUT);
            if let Some(state) = self.ports.newest_state().unwrap() {
                self.state = state;
            }
            sequence += 1;
            let mut message = SetpointMessage { lease, sequence, joint_count: 1, ..Default::default() };
            message.time_ns = motord_ports::clock::now_ns();
            let position = self.state.joints[0].position;
            message.joints[0] = JointSetpoint { position, kp: 20.0, kd: 1.0, ..Default::default() };
            port.send(&message).unwrap();
            enabled = enabled || self.ask(Operation::Enable, lease).1 == 0;
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

fn disarmed(state: &StateMessage) -> bool {
    state.groups[0].phase == Phase::Disarmed.code()
}

/// Goal: the log of a session contains each event with its actor and its cause, and nothing else.
/// Method: start, enable, a controller that stops sending, reset, emergency stop, a motor
/// unplugged, stop.
#[test]
fn journal_names_actor_and_cause_of_each_event() {
    let daemon = start(true);
    let instance = instance(&daemon);
    let mut controller = Requester::of(&instance);
    controller.activate();
    // The controller sends no more setpoints, as if it were killed.
    controller.until(disarmed);
    let mut operator = controller;
    assert_eq!(operator.ask(Operation::Reset, 0).1, 0);
    operator.activate();
    assert_eq!(operator.ask(Operation::EmergencyStop, 0).1, 0);
    operator.until(disarmed);
    assert_ne!(operator.ask(Operation::Enable, 0).1, 0);
    inject(&instance, "elbow off").unwrap();
    operator.until(|state| state.joints[0].mode == MotorMode::Offline.code());
    // The telemetry thread logs the events in its own period.
    std::thread::sleep(Duration::from_millis(200));
    let lines = end(daemon);
    let log = lines.join("\n");
    // This machine's own: one line for each real-time setting that it refuses, and for its late ticks.
    let machine = |line: &&String| line.contains("Without it") || line.contains("ticks were missed");
    let events: Vec<&String> = lines.iter().filter(|line| !machine(line)).collect();
    assert!(events.len() <= 25, "{log}");
    let errors: Vec<&&String> = events.iter().filter(|line| line.starts_with("<3>")).collect();
    assert_eq!(errors.len(), 2, "{log}");
    assert!(
        errors[0].contains("cause=\"setpoint-timeout\"") && errors[1].contains("cause=\"emergency-stop\"")
    );
    assert_events_are_named(&events, &log);
    let has_priority = |line: &&&String| line.starts_with('<') && line.as_bytes()[2] == b'>';
    assert!(events.iter().all(|line| has_priority(&line)), "{log}");
    for (index, line) in events.iter().enumerate() {
        assert!(!events[..index].contains(line), "twice: {line}");
    }
}

/// Checks the level, the words and the process of each event.
fn assert_events_are_named(events: &[&String], log: &str) {
    let process = format!("pid={}", std::process::id());
    for (level, words) in [
        ("<6>", ["ready", "motors=1"]),
        ("<6>", ["claimed", &process]),
        ("<6>", ["enabled", &process]),
        ("<3>", ["setpoint-timeout", &process]),
        ("<3>", ["emergency-stop", &process]),
        ("<6>", ["reset", &process]),
        ("<6>", ["refused: The emergency stop is latched", &process]),
        ("<6>", ["simulated fault", &process]),
        ("<4>", ["does not answer any more", "elbow"]),
        ("<6>", ["damping and stopping", "SIGTERM"]),
        ("<6>", ["the motors are stopped", ""]),
    ] {
        let found =
            events.iter().any(|line| line.starts_with(level) && words.iter().all(|word| line.contains(word)));
        assert!(found, "{level} {words:?} in\n{log}");
    }
}

/// At this rate the first cycle would end long after a daemon that did not wait for it is ready.
#[test]
fn ready_daemon_has_published_its_first_state() {
    let mut daemon = Daemon::start(&config(5));
    let await_ready = |daemon: &Daemon, starts| {
        until("readiness", || (daemon.log().matches(" ready ").count() == starts).then_some(()));
    };
    await_ready(&daemon, 1);
    let client = Client::connect_in(daemon.directory.path(), "bench").unwrap();
    let before = client.wait(TIMEOUT).unwrap();
    daemon.kill();
    daemon.restart();
    await_ready(&daemon, 2);
    let first = client.newest();
    assert_eq!(first.unwrap_err(), Error::Restarted, "after cycle {}", before.cycle());
}

#[test]
fn terminal_and_file_logs_have_time_and_level() {
    let daemon = start(false);
    let _running = Requester::of(&instance(&daemon));
    let lines = end(daemon);
    assert!(lines.iter().all(|line| line.starts_with("20") && line.contains('Z')), "{lines:?}");
    assert!(lines.iter().any(|line| line.contains(" INFO ready ")), "{lines:?}");
}

#[test]
fn refused_configuration_is_an_error_in_journal() {
    let directory = TempDir::new().unwrap();
    let (mut reader, writer) = std::io::pipe().unwrap();
    let stream = nix::sys::stat::fstat(writer.as_fd()).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_motord"));
    command.arg("run").arg("--config").arg(Path::new("missing.toml")).stderr(writer);
    command.env("JOURNAL_STREAM", format!("{}:{}", stream.st_dev, stream.st_ino));
    assert_eq!(command.current_dir(directory.path()).status().unwrap().code(), Some(78));
    drop(command);
    let mut text = String::new();
    reader.read_to_string(&mut text).unwrap();
    assert!(!text.is_empty() && text.lines().all(|line| line.starts_with("<3>")), "{text}");
}
