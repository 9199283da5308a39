//! The emergency stop during faults: the real programs, a robot that moves, and one fault after the
//! other.
//!
//! Prints the table of docs/safety.md:
//! `cargo test -p motord --test process worst_moments -- --nocapture`.
//!
//! The stop counts from the cycle in which it was latched: the commands that damp the motors are
//! sent in the same cycle.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use crate::player::become_user;
use motord_harness::daemon::{Daemon, TIMEOUT, bench_at, until};
use motord_harness::programs::lacks;
use motord_ports::ClientPorts;
use motord_ports::instance::Instance;
use motord_ports::stop_socket::{AskedStop, StopError};
use motord_shared::message::{ALL_GROUPS, AdminReply};
use motord_shared::{AdminRequest, Cause, JointSetpoint, Operation, Phase, SetpointMessage, StateMessage};
use nix::sys::ptrace;
use nix::sys::signal::{Signal, kill};
use nix::sys::wait::{WaitPidFlag, waitpid};
use nix::unistd::Pid;
use rustix::process::{Resource, Rlimit, getrlimit, prlimit};
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Variable for a process that sends requests without pause: its runtime directory.
const ASK: &str = "MOTORD_TEST_ASK";
/// Variable for a process in separate namespaces, which may mount.
const INSIDE: &str = "MOTORD_TEST_INSIDE";
/// Variable for a process that becomes another user and sends a request: its runtime directory.
const INTRUDE: &str = "MOTORD_TEST_INTRUDE";
/// A user and a group that own nothing.
const NOBODY: u32 = 65_534;
/// Number of processes that send requests without pause.
const CROWD: usize = 24;

/// Held by a test of this file: the crowd of one is an overload for the robot of another.
static ALONE: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A daemon, and its motor that follows setpoints.
struct Robot {
    daemon: Daemon,
    ports: Arc<ClientPorts>,
    over: Arc<AtomicBool>,
    owner: Option<JoinHandle<()>>,
}

impl Robot {
    /// Starts the daemon in `directory`, and waits until the motor is active.
    fn start(directory: TempDir) -> Self {
        let daemon = Daemon::start_in(directory, &bench_at(200), |_| {});
        let ports = Arc::new(until("the daemon runs", || attached(daemon.directory.path())));
        let over = Arc::new(AtomicBool::new(false));
        let mut robot = Self { daemon, ports, over, owner: None };
        robot.activate();
        robot
    }

    /// Returns the runtime directory.
    fn directory(&self) -> &Path {
        self.daemon.directory.path()
    }

    /// Claims the arm, and holds it from a thread.
    fn activate(&mut self) {
        let position = until("a position", || {
            let joint = self.state()?.joints[0];
            (joint.receive_ns != 0).then_some(joint.position)
        });
        let lease = self.ask(Operation::Claim).unwrap().lease;
        let (ports, over) = (Arc::clone(&self.ports), Arc::clone(&self.over));
        self.owner = Some(spawn(move || hold(&ports, lease, position, &over)));
        until("an owner", || (self.ask(Operation::Enable)?.refusal == 0).then_some(()));
        let begun = Instant::now();
        while self.phase() != Some(Phase::Active) {
            assert!(begun.elapsed() < TIMEOUT, "no active arm");
            sleep(Duration::from_millis(1));
        }
    }

    fn ask(&self, operation: Operation) -> Option<AdminReply> {
        Some(self.answer(operation)?.0)
    }

    fn answer(&self, operation: Operation) -> Option<(AdminReply, Vec<u8>)> {
        let request = AdminRequest { operation: operation.code(), group: 0, ..Default::default() };
        let question = self.ports.ask(request).ok()?;
        let begun = Instant::now();
        while begun.elapsed() < TIMEOUT {
            if let Some(answer) = question.answer().ok()? {
                return Some(answer);
            }
            sleep(Duration::from_millis(1));
        }
        None
    }

    fn state(&self) -> Option<StateMessage> {
        until("a state", || self.ports.newest_state().ok().flatten()).into()
    }

    fn phase(&self) -> Option<Phase> {
        Phase::try_from(self.state()?.groups[0].phase).ok()
    }

    /// Returns the tick of the stop's cycle, as a time after `since_ns`, ns of the monotonic clock.
    fn stopped_after(&self, since_ns: u64) -> Duration {
        let stop_cycle = until("the cycle of the stop", || {
            let telemetry: serde_json::Value =
                serde_json::from_slice(&self.answer(Operation::Telemetry)?.1).unwrap();
            telemetry["groups"][0]["stop_cycle"].as_u64()
        });
        let state = self.state().unwrap();
        let tick_ns = state.tick_ns - (state.cycle - stop_cycle) * 5_000_000;
        Duration::from_nanos(tick_ns.saturating_sub(since_ns))
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        let _held = self.owner.take().map(JoinHandle::join);
        let _signal = kill(self.daemon.pid(), Signal::SIGCONT);
    }
}

fn attached(runtime: &Path) -> Option<ClientPorts> {
    let instance = Instance::below(runtime, "bench").unwrap();
    ClientPorts::open(instance.attach().ok()??).ok()
}

/// Holds the joint at `position` until `over` is set.
fn hold(ports: &ClientPorts, lease: u64, position: f32, over: &AtomicBool) {
    let port = ports.setpoint_port().unwrap();
    for sequence in 1.. {
        if over.load(Ordering::Relaxed) {
            return;
        }
        let time_ns = motord_ports::clock::now_ns();
        let mut message = SetpointMessage { lease, sequence, time_ns, joint_count: 1, ..Default::default() };
        message.joints[0] = JointSetpoint { position, kp: 40.0, kd: 1.0, ..Default::default() };
        // A fault may damage the connection: then the missing setpoints also stop the robot.
        let _damaged = port.send(&message);
        sleep(Duration::from_millis(5));
    }
}

/// A fault that lasts until it is dropped.
type Misfortune = Box<dyn std::any::Any>;
type Begin = fn(&Robot) -> Misfortune;

/// Ends a fault.
struct Undo<F: FnMut()>(F);

impl<F: FnMut()> Drop for Undo<F> {
    fn drop(&mut self) {
        (self.0)();
    }
}

fn none(_: &Robot) -> Misfortune {
    Box::new(())
}

fn file_system_full(robot: &Robot) -> Misfortune {
    let path = robot.directory().join("filler");
    let mut file = fs::File::create(&path).unwrap();
    let full = std::io::copy(&mut std::io::repeat(0), &mut file).unwrap_err();
    assert_eq!(full.raw_os_error(), Some(nix::libc::ENOSPC), "{full}");
    Box::new(Undo(move || fs::remove_file(&path).unwrap()))
}

fn directory_emptied(robot: &Robot) -> Misfortune {
    for entry in fs::read_dir(robot.directory()).unwrap().map(Result::unwrap) {
        let path = entry.path();
        if path.is_dir() { fs::remove_dir_all(path).unwrap() } else { fs::remove_file(path).unwrap() }
    }
    Box::new(())
}

fn descriptors_used_up(robot: &Robot) -> Misfortune {
    let pid = rustix::process::Pid::from_raw(robot.daemon.process.id().cast_signed());
    let used = fs::read_dir(format!("/proc/{}/fd", robot.daemon.process.id())).unwrap().count();
    let limit = move |most: u64| {
        let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
        prlimit(pid, Resource::Nofile, Rlimit { current: Some(most), maximum })
    };
    limit(used as u64).unwrap();
    Box::new(Undo(move || {
        let _back = limit(1024);
    }))
}

fn slots_taken(robot: &Robot) -> Misfortune {
    let instance = Instance::below(robot.directory(), "bench").unwrap();
    let mut taken = Vec::new();
    while let Ok(ports) = ClientPorts::open_to_stop(instance.attach().unwrap().unwrap()) {
        taken.push(ports);
    }
    assert!(taken.len() >= 28, "{}", taken.len());
    Box::new(taken)
}

fn crowd(robot: &Robot) -> Misfortune {
    let requester = || {
        let mut requester = Command::new(std::env::current_exe().unwrap());
        requester
            .args(["--exact", "worst_moments::one_of_the_crowd", "--nocapture"])
            .env(ASK, robot.directory());
        requester.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    };
    let mut crowd: Vec<Child> = (0..CROWD).map(|_| requester()).collect();
    sleep(Duration::from_secs(3));
    assert!(crowd.iter_mut().all(|requester| requester.try_wait().unwrap().is_none()), "they ask on");
    Box::new(Undo(move || {
        for requester in &mut crowd {
            requester.kill().unwrap();
            requester.wait().unwrap();
        }
    }))
}

fn daemon_frozen(robot: &Robot) -> Misfortune {
    let pid = robot.daemon.pid();
    kill(pid, Signal::SIGSTOP).unwrap();
    Box::new(Undo(move || kill(pid, Signal::SIGCONT).unwrap()))
}

/// Stops the whole ipc thread while the other threads of the daemon run: a debugger stops one
/// thread only.
fn ipc_thread_hangs(robot: &Robot) -> Misfortune {
    let tasks =
        fs::read_dir(format!("/proc/{}/task", robot.daemon.pid())).unwrap().map(|task| task.unwrap().path());
    let is_ipc =
        |task: &PathBuf| fs::read_to_string(task.join("comm")).is_ok_and(|comm| comm.trim() == "motord-ipc");
    let task = tasks.into_iter().find(is_ipc).unwrap();
    let thread = Pid::from_raw(task.file_name().unwrap().to_str().unwrap().parse().unwrap());
    ptrace::seize(thread, ptrace::Options::empty()).unwrap();
    ptrace::interrupt(thread).unwrap();
    waitpid(thread, Some(WaitPidFlag::__WALL)).unwrap();
    Box::new(Undo(move || ptrace::detach(thread, None).unwrap()))
}

/// Sends requests without pause, if the variable is set.
#[test]
fn one_of_the_crowd() {
    let Some(runtime) = std::env::var_os(ASK) else { return };
    let ports = until("a place", || attached(Path::new(&runtime)));
    let request =
        AdminRequest { operation: Operation::Enable.code(), group: ALL_GROUPS, ..Default::default() };
    loop {
        // Kept until it is answered or given up: at most two at a time.
        let questions = [ports.ask(request), ports.ask(request)];
        drop(questions);
    }
}

/// One row of the table.
struct Row {
    misfortune: &'static str,
    status: Option<i32>,
    printed: String,
    answered_after: Duration,
    damped_after: Duration,
    group: motord_shared::GroupState,
}

fn row(misfortune: &'static str, directory: TempDir, begin: Begin) -> Row {
    let robot = Robot::start(directory);
    let happens = begin(&robot);
    let (since_ns, begun) = (motord_ports::clock::now_ns(), Instant::now());
    let mut motorctl = robot.daemon.command(&["estop"]);
    let mut motorctl = motorctl.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut printed = String::new();
    BufReader::new(motorctl.stdout.take().unwrap()).read_line(&mut printed).unwrap();
    let answered_after = begun.elapsed();
    let Output { status, stderr, .. } = motorctl.wait_with_output().unwrap();
    printed += str::from_utf8(&stderr).unwrap();
    drop(happens);
    let latched = || {
        let group = robot.state()?.groups[0];
        (group.cause == Cause::EmergencyStop.code()).then_some(group)
    };
    let group = until("a latched stop", latched);
    let damped_after = robot.stopped_after(since_ns);
    Row { misfortune, status: status.code(), printed, answered_after, damped_after, group }
}

impl Row {
    fn print(&self) {
        let Self { misfortune, status, printed, answered_after, damped_after, .. } = self;
        let first = printed.lines().next().unwrap_or_default();
        println!(
            "| {misfortune} | {first} | {} | {answered_after:.0?} | {damped_after:.0?} |",
            status.unwrap_or(-1)
        );
    }

    fn must_be_confirmed(&self) {
        assert_eq!(self.status, Some(0), "{}: {}", self.misfortune, self.printed);
        assert!(self.printed.starts_with("confirmed: "), "{}: {}", self.misfortune, self.printed);
        assert_ne!(self.group.cause_pid, 0, "{}", self.misfortune);
    }
}

#[test]
fn emergency_stop_is_confirmed_in_worst_moments() {
    let _alone = alone();
    let moments: [(&str, Begin); 6] = [
        ("none", none),
        ("the directory is emptied", directory_emptied),
        ("the descriptors are used up", descriptors_used_up),
        ("all slots are in use", slots_taken),
        ("24 processes ask without pause", crowd),
        ("the ipc thread hangs", ipc_thread_hangs),
    ];
    for (misfortune, begin) in moments {
        let row = row(misfortune, TempDir::new().unwrap(), begin);
        row.print();
        row.must_be_confirmed();
    }
    let frozen = row("the daemon is frozen", TempDir::new().unwrap(), daemon_frozen);
    frozen.print();
    assert_eq!(frozen.status, Some(79), "{}", frozen.printed);
    assert!(frozen.printed.contains("EMERGENCY STOP NOT CONFIRMED: cut the power"), "{}", frozen.printed);
    assert!(frozen.damped_after > Duration::from_millis(500), "it was carried out when the daemon went on");
}

/// Runs in separate namespaces: a small file system is mounted.
#[test]
fn emergency_stop_is_confirmed_on_full_filesystem() {
    const NAME: &str = "worst_moments::emergency_stop_is_confirmed_on_full_filesystem";
    if std::env::var_os(INSIDE).is_none() {
        if lacks(&["unshare", "mount"]) {
            return;
        }
        let _alone = alone();
        let mut inside = Command::new("unshare");
        inside.args(["--user", "--map-root-user", "--mount"]).arg(std::env::current_exe().unwrap());
        inside.args(["--exact", NAME, "--nocapture"]).env(INSIDE, "1");
        let status = inside.status();
        let is_refused =
            !Command::new("unshare").args(["-Urm", "true"]).status().is_ok_and(|may| may.success());
        if is_refused {
            println!("NOT TESTED: this computer allows no such namespaces");
        }
        assert!(is_refused || status.unwrap().success());
        return;
    }
    let directory = TempDir::new().unwrap();
    let mut mount = Command::new("mount");
    mount.args(["-t", "tmpfs", "-o", "size=64m,mode=700", "tmpfs"]).arg(directory.path());
    assert!(mount.status().unwrap().success());
    let row = row("the runtime file system is full", directory, file_system_full);
    row.print();
    row.must_be_confirmed();
}

/// Connects, becomes another user and sends a request, if the variable is set.
#[test]
fn an_intruder_asks() {
    let Some(runtime) = std::env::var_os(INTRUDE) else { return };
    let instance = Instance::below(Path::new(&runtime), "bench").unwrap();
    become_user(NOBODY);
    let asked = AskedStop::send(&instance, TIMEOUT).unwrap();
    assert_eq!(asked.confirm(TIMEOUT), Err(StopError::NotPermitted));
}

#[test]
fn nobody_else_may_stop_the_robot() {
    if !nix::unistd::geteuid().is_root() {
        println!("not run: only root can become another user");
        return;
    }
    let robot = Robot::start(TempDir::new().unwrap());
    let mut intruder = Command::new(std::env::current_exe().unwrap());
    intruder
        .args(["--exact", "worst_moments::an_intruder_asks", "--nocapture"])
        .env(INTRUDE, robot.directory());
    assert!(intruder.status().unwrap().success());
    assert_eq!(robot.phase(), Some(Phase::Active));
}

/// Goal: motors that keep their last command are not taken for stopped ones.
#[test]
fn daemon_that_died_is_named_until_the_next() {
    let connect = |directory: &Path| motord_client::Client::connect_in(directory, "bench");
    let died = |directory: &Path| match connect(directory) {
        Err(motord_client::Error::NotRunning { died, .. }) => died,
        other => panic!("{other:?}"),
    };
    let _alone = alone();
    for signal in [Signal::SIGTERM, Signal::SIGKILL] {
        let mut robot = Robot::start(TempDir::new().unwrap());
        robot.daemon.signal(signal);
        robot.daemon.wait();
        let expected = (signal == Signal::SIGKILL).then_some(robot.daemon.process.id());
        assert_eq!(died(robot.directory()), expected, "{signal}");
        let text = connect(robot.directory()).unwrap_err().to_string();
        assert_eq!(text.contains("died without stopping its motors"), expected.is_some(), "{text}");
    }
}
