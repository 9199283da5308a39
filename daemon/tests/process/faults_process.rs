//! The fault catalogue, part C: faults of the daemon as a process. `docs/faults.md` names the item
//! of each test.
//!
//! Method: the real program with one simulated motor. The test listens instead of systemd
//! (`sd_notify(3)`): the daemon feeds the watchdog only while its cycle runs.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_harness::daemon::{BENCH, Daemon, TIMEOUT};
use motord_harness::programs::lacks;
use motord_ports::{ClientPorts, Instance};
use motord_shared::limits::{ADMINS_MAX, CONTROLLERS_MAX, STOP_SLOTS};
use motord_shared::message::AdminReply;
use motord_shared::{AdminRequest, Cause, JointSetpoint, Operation, Phase, SetpointMessage, StateMessage};
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::sys::ptrace;
use nix::sys::signal::Signal;
use nix::sys::wait::{WaitPidFlag, waitpid};
use nix::unistd::Pid;
use std::fs::{self, File};
use std::io::{ErrorKind, Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixDatagram;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const READY: &str = "READY=1";
const FED: &str = "WATCHDOG=1";
/// `WatchdogSec=` of the unit, and half of it.
const WATCHDOG: Duration = Duration::from_secs(3);
/// Runs its arguments unchanged.
const PLAINLY: &str = r#"exec "$@""#;

/// A daemon with a socket of systemd.
struct Service {
    daemon: Daemon,
    notes: UnixDatagram,
}

impl Service {
    /// Starts it by the shell's `script`, which runs its arguments.
    fn start(script: &str, config: &str) -> Self {
        Self::start_as(script, config, |_| {})
    }

    fn start_as(script: &str, config: &str, adjust: impl FnOnce(&mut Command)) -> Self {
        let directory = TempDir::new().unwrap();
        let path = directory.path().join("notes");
        let notes = UnixDatagram::bind(&path).unwrap();
        let daemon = Daemon::start_by(script, directory, config, |command| {
            command.env("NOTIFY_SOCKET", path).stdin(Stdio::piped()).stdout(Stdio::piped());
            adjust(command);
        });
        Self { daemon, notes }
    }

    fn plain() -> Self {
        let mut service = Self::start(PLAINLY, BENCH);
        service.must_report(READY);
        service
    }

    /// Returns the runtime directory.
    fn directory(&self) -> &Path {
        self.daemon.directory.path()
    }

    /// Returns `true` if it sends `note` to systemd within `time`, before it ends.
    fn reports(&mut self, note: &str, time: Duration) -> bool {
        let (begun, mut bytes) = (Instant::now(), [0; 256]);
        self.notes.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        while begun.elapsed() < time {
            match self.notes.recv(&mut bytes) {
                Ok(length) if bytes[..length].starts_with(note.as_bytes()) => return true,
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    if self.daemon.process.try_wait().unwrap().is_some() {
                        return false;
                    }
                }
                other => drop(other.unwrap()),
            }
        }
        false
    }

    fn must_report(&mut self, note: &str) {
        assert!(self.reports(note, TIMEOUT), "it never said {note}");
    }

    /// Checks that it is healthy, and exits cleanly on request.
    fn must_live_and_end(mut self) {
        self.must_report(FED);
        self.must_report(FED);
        assert!(self.daemon.end().success());
    }

    /// Checks that it either exits before it is ready, with a reason, or becomes ready and exits
    /// cleanly.
    fn must_refuse_or_run(mut self) -> Option<i32> {
        if self.reports(READY, TIMEOUT) {
            assert!(self.daemon.end().success());
            return None;
        }
        let status = self.daemon.wait();
        let code = status.code().filter(|code| (64..=78).contains(code));
        assert!(code.is_some(), "{status}, signal {:?}: {}", status.signal(), self.daemon.log());
        code
    }
}

/// A controller and operator, through the bare services.
struct Operator {
    ports: ClientPorts,
    sequence: u64,
    lease: u64,
    state: StateMessage,
}

impl Operator {
    fn of(service: &Service) -> Self {
        let instance = Instance::below(service.directory(), "bench").unwrap();
        let ports = ClientPorts::open(instance.attach().unwrap().unwrap()).unwrap();
        Self { ports, sequence: 0, lease: 0, state: StateMessage::default() }
    }

    fn ask(&self, operation: Operation) -> AdminReply {
        let request = AdminRequest { lease: self.lease, operation: operation.code(), ..Default::default() };
        let (begun, question) = (Instant::now(), self.ports.ask(request).unwrap());
        loop {
            if let Some((reply, _)) = question.answer().unwrap() {
                return reply;
            }
            assert!(begun.elapsed() < TIMEOUT, "no answer to {operation}");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Reads the newest state. Returns `true` if there was one.
    fn refresh(&mut self) -> bool {
        let newest = self.ports.newest_state().unwrap();
        newest.map(|state| self.state = state).is_some()
    }

    fn phase(&self) -> Phase {
        self.state.groups[0].phase.try_into().unwrap()
    }

    /// Claims the arm, and holds it until it is active and stiff.
    fn activate(&mut self) {
        self.lease = self.ask(Operation::Claim).lease;
        let port = self.ports.setpoint_port().unwrap();
        let (begun, mut enabled) = (Instant::now(), false);
        while self.phase() != Phase::Active || self.state.joints[0].applied.kp < 39.0 {
            assert!(begun.elapsed() < TIMEOUT, "{}", self.phase());
            if self.refresh() && self.state.joints[0].position.is_finite() {
                self.sequence += 1;
                let mut message =
                    SetpointMessage { lease: self.lease, sequence: self.sequence, ..Default::default() };
                message.time_ns = motord_ports::clock::now_ns();
                message.joint_count = 1;
                let position = self.state.joints[0].position;
                message.joints[0] = JointSetpoint { position, kp: 40.0, kd: 1.0, ..Default::default() };
                port.send(&message).unwrap();
                enabled = enabled || self.ask(Operation::Enable).refusal == 0;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

#[test]
fn terminated_daemon_damps_and_stops_first() {
    for signal in [Signal::SIGTERM, Signal::SIGINT] {
        let mut service = Service::plain();
        let mut operator = Operator::of(&service);
        operator.activate();
        service.daemon.signal(signal);
        let begun = Instant::now();
        let status = loop {
            let is_new = operator.refresh();
            let applied = operator.state.joints[0].applied;
            if is_new && operator.phase() == Phase::Damping {
                assert!(applied.kp == 0.0 && applied.kd > 0.0 && applied.torque == 0.0, "{applied:?}");
            }
            if let Some(status) = service.daemon.process.try_wait().unwrap() {
                break status;
            }
            assert!(begun.elapsed() < TIMEOUT);
        };
        operator.refresh();
        assert!(status.success(), "{signal}: {status}");
        assert_eq!(operator.phase(), Phase::Disarmed, "{signal}");
        assert_eq!(operator.state.groups[0].cause, Cause::Shutdown.code());
    }
}

/// The joint of this test never counts as slow: half a code of velocity is above the limit.
#[test]
fn a_second_signal_ends_the_damping_at_once() {
    let config = BENCH.replace("[[bus]]", "damp-seconds = 30.0\nrest-velocity-rad-s = 0.01\n[[bus]]");
    let mut service = Service::start(PLAINLY, &config);
    service.must_report(READY);
    let mut operator = Operator::of(&service);
    operator.activate();
    service.daemon.signal(Signal::SIGTERM);
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_millis(500) || operator.phase() == Phase::Active {
        operator.refresh();
    }
    assert_eq!(operator.phase(), Phase::Damping);
    service.daemon.signal(Signal::SIGTERM);
    assert!(service.daemon.wait().success());
    operator.refresh();
    assert_eq!(operator.phase(), Phase::Disarmed);
}

/// The unit's `TimeoutStopSec=` is shorter than the longest damping.
#[test]
fn terminated_daemon_asks_systemd_to_wait() {
    let config = BENCH.replace("[[bus]]", "damp-seconds = 30.0\n[[bus]]");
    let mut service = Service::start(PLAINLY, &config);
    service.must_report(READY);
    service.daemon.signal(Signal::SIGTERM);
    service.must_report("STOPPING=1\nEXTEND_TIMEOUT_USEC=33000000");
    assert!(service.daemon.wait().success());
}

#[test]
fn a_hangup_is_no_reason_to_end() {
    let service = Service::plain();
    service.daemon.signal(Signal::SIGHUP);
    service.must_live_and_end();
}

/// Goal: systemd ends a daemon whose cycle stalls while its other threads run.
/// Method: only the thread of the cycle is stopped, as a debugger does.
#[test]
fn watchdog_is_not_fed_while_cycle_stalls() {
    let mut service = Service::plain();
    service.must_report(FED);
    let cycle = thread(service.daemon.pid(), "motord-cycle");
    hold(cycle);
    // Notifications in flight, and one more turn of the feeding thread, which saw the cycle move
    // before the stop.
    while service.reports(FED, Duration::from_millis(1500)) {}
    assert!(!service.reports(FED, WATCHDOG));
    ptrace::detach(cycle, None).unwrap();
    service.must_live_and_end();
}

/// Goal: systemd does not end a daemon that controls its robot while telemetry is busy.
/// Method: only the thread of telemetry is stopped. Its cleanup after thousands of dead clients
/// takes seconds.
#[test]
fn the_watchdog_is_fed_while_telemetry_stands_still() {
    let mut service = Service::plain();
    service.must_report(FED);
    let telemetry = thread(service.daemon.pid(), "motord-telemetr");
    hold(telemetry);
    // The first notification may have been in flight.
    let fed = (0..3).filter(|_| service.reports(FED, TIMEOUT)).count();
    ptrace::detach(telemetry, None).unwrap();
    assert_eq!(fed, 3);
    service.must_live_and_end();
}

fn hold(thread: Pid) {
    ptrace::seize(thread, ptrace::Options::empty()).unwrap();
    ptrace::interrupt(thread).unwrap();
    waitpid(thread, Some(WaitPidFlag::__WALL)).unwrap();
}

fn thread(pid: Pid, name: &str) -> Pid {
    let threads = fs::read_dir(format!("/proc/{pid}/task")).unwrap().map(Result::unwrap);
    let is_named = |path: &Path| fs::read_to_string(path.join("comm")).is_ok_and(|comm| comm.trim() == name);
    let path = threads.map(|entry| entry.path()).find(|path| is_named(path)).unwrap();
    Pid::from_raw(path.file_name().unwrap().to_str().unwrap().parse().unwrap())
}

/// Root must also drop its capabilities; a user has none.
fn without_rights() -> String {
    let drop = "setpriv --bounding-set=-sys_nice,-ipc_lock --inh-caps=-all";
    let prefix = if nix::unistd::geteuid().is_root() { drop } else { "" };
    format!(r#"ulimit -r 0; ulimit -l 64; exec {prefix} "$@""#)
}

#[test]
fn unprivileged_daemon_runs_and_reports_missing_rights() {
    let mut service = Service::start(&without_rights(), BENCH);
    service.must_report(READY);
    assert!(service.daemon.end().success());
    let log = service.daemon.log();
    for word in ["SCHED_FIFO: no", "locked memory: no", "LimitMEMLOCK=infinity", "processors kept awake"] {
        assert!(log.contains(word), "{word} in\n{log}");
    }
    // The remedy for a user, or the reason for root.
    assert!(log.contains("LimitRTPRIO=90") || log.contains("root has no CAP_SYS_NICE"), "{log}");
}

#[test]
fn required_realtime_is_refused_without_rights() {
    let config = BENCH.replace("rate-hz = 100", "rate-hz = 100\nrequire-realtime = true");
    let mut service = Service::start(&without_rights(), &config);
    assert!(!service.reports(READY, TIMEOUT));
    assert_eq!(service.daemon.wait().code(), Some(78));
    let log = service.daemon.log();
    assert!(log.contains("LimitRTPRIO"), "{log}");
}

/// Goal: a lack of space for shared memory is an error at the start, not a later death by SIGBUS.
/// Method: a file system of a few pages, in a separate namespace.
#[test]
fn full_filesystem_is_error_before_motion() {
    if !may_mount() {
        return;
    }
    for size in ["4k", "64k", "256k", "1m", "4m"] {
        let service = Service::start(&on_file_system(size, PLAINLY), BENCH);
        assert!(service.must_refuse_or_run().is_some(), "{size} are not enough");
    }
}

#[test]
fn filling_filesystem_does_not_kill_the_daemon() {
    if !may_mount() {
        return;
    }
    let script = r#""$@" & motord=$!; read -r _; head -c 64m /dev/zero >"$MOTORD_RUNTIME_DIR/full" 2>&1 || echo full
        read -r _; kill -TERM $motord; wait $motord"#;
    let mut service = Service::start(&on_file_system("32m", script), BENCH);
    let mut shell = service.daemon.process.stdin.take().unwrap();
    service.must_report(READY);
    shell.write_all(b"go on\n").unwrap();
    let mut full = [0; 4];
    service.daemon.process.stdout.take().unwrap().read_exact(&mut full).unwrap();
    assert_eq!(&full, b"full");
    (0..3).for_each(|_| service.must_report(FED));
    shell.write_all(b"end\n").unwrap();
    assert!(service.daemon.wait().success());
}

/// Runs `script` where the runtime directory is a file system of `size`.
fn on_file_system(size: &str, script: &str) -> String {
    let mount = format!(r#"mount -t tmpfs -o size={size} tmpfs "$MOTORD_RUNTIME_DIR/small""#);
    let inside = format!(r#"{mount} && export MOTORD_RUNTIME_DIR="$MOTORD_RUNTIME_DIR/small"; {script}"#);
    format!(
        "mkdir \"$MOTORD_RUNTIME_DIR/small\"; exec unshare --map-root-user --mount sh -c '{inside}' sh \"$@\""
    )
}

fn may_mount() -> bool {
    if lacks(&["unshare", "mount"]) {
        return false;
    }
    let mut mount = Command::new("unshare");
    mount.args(["--map-root-user", "--mount", "mount", "-t", "tmpfs", "tmpfs", "/mnt"]);
    let may = mount.output().is_ok_and(|output| output.status.success());
    if !may {
        println!("not tested: this machine lets nobody mount a file system");
    }
    may
}

/// Goal: a robot that no client can reach stops, and no second daemon starts beside it.
/// Method: each of the files is removed while a controller holds a stiff joint. It receives the
/// stop over its connection.
#[test]
fn removed_files_stop_robot_and_report_cause() {
    for removed in ["", "bench.lock", "iox", "iox/bench.cycle", "iox/bench", "iox/bench/services"] {
        let mut service = Service::start(PLAINLY, BENCH);
        service.must_report(READY);
        let mut operator = Operator::of(&service);
        operator.activate();
        let path = service.directory().join(removed);
        if path.is_dir() {
            fs::remove_dir_all(&path).unwrap();
        } else {
            fs::remove_file(&path).unwrap();
        }
        let begun = Instant::now();
        while operator.phase() == Phase::Active {
            operator.refresh();
            assert!(begun.elapsed() < TIMEOUT, "{removed:?} is gone, and the robot goes on");
        }
        assert_eq!(operator.state.groups[0].cause, Cause::DirectoryLost.code(), "{removed:?}");
        assert_eq!(service.daemon.wait().code(), Some(69), "{removed:?}");
        operator.refresh();
        assert_eq!(operator.phase(), Phase::Disarmed, "{removed:?}");
        let log = service.daemon.log();
        assert!(log.contains("was removed or replaced"), "{removed:?}: {log}");
    }
}

/// Goal: truncated or overwritten shared memory does not keep the robot from being driven again.
/// Method: a client that waits for its daemon keeps the files of the dead one. At most one
/// successor may die of them.
#[test]
fn damaged_shared_memory_costs_at_most_one_start() {
    for damage in [
        |_| Vec::new(),
        |bytes: Vec<u8>| bytes[..bytes.len() / 2].to_vec(),
        |bytes: Vec<u8>| vec![0xA5; bytes.len()],
    ] {
        let mut service = Service::plain();
        let client = Instance::below(service.directory(), "bench").unwrap().attach().unwrap();
        service.daemon.signal(Signal::SIGKILL);
        service.daemon.wait();
        for path in files(&service.directory().join("iox")) {
            let damaged = damage(fs::read(&path).unwrap());
            // Some files are read-only, but their owner may delete them.
            fs::remove_file(&path).unwrap();
            fs::write(&path, damaged).unwrap();
        }
        let runs = |service: &mut Service| {
            let notes = service.directory().join("notes");
            service.daemon.restart_as(|command| {
                command.env("NOTIFY_SOCKET", notes);
            });
            service.reports(READY, TIMEOUT)
        };
        assert!(runs(&mut service) || runs(&mut service), "no daemon starts any more");
        drop(client);
        service.must_live_and_end();
    }
}

fn files(below: &Path) -> Vec<std::path::PathBuf> {
    let entries = fs::read_dir(below).unwrap().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

#[test]
fn odd_character_in_runtime_directory_is_refused() {
    for odd in ["r\u{f6}bot", "a*b"] {
        let script = format!(
            "mkdir \"$MOTORD_RUNTIME_DIR/{odd}\"; export MOTORD_RUNTIME_DIR=\"$MOTORD_RUNTIME_DIR/{odd}\"; exec \"$@\""
        );
        let mut service = Service::start(&script, BENCH);
        assert_eq!(service.daemon.wait().code(), Some(78), "{odd}");
        let log = service.daemon.log();
        assert!(log.contains("MOTORD_RUNTIME_DIR") && !log.contains("panicked"), "{log}");
    }
}

#[test]
fn a_verdict_stands_although_its_reader_has_gone() {
    let directory = TempDir::new().unwrap();
    let path = directory.path().join("motord.toml");
    for (config, status) in [(BENCH, 0), ("nonsense", 78)] {
        fs::write(&path, config).unwrap();
        let mut command = Command::new("sh");
        // The reader exits before the daemon writes its report.
        command.args([
            "-c",
            r#"{ sleep 0.5; "$@"; echo $? >&2; } | true"#,
            "sh",
            env!("CARGO_BIN_EXE_motord"),
        ]);
        let output = command.args(["check", "--config"]).arg(&path).output().unwrap();
        assert_eq!(String::from_utf8(output.stderr).unwrap().trim(), status.to_string());
    }
}

#[test]
fn unwritable_log_does_not_stop_the_daemon() {
    let full = File::options().write(true).open("/dev/full").unwrap();
    let closed = r#"exec 2>&-; exec "$@""#;
    for (script, stderr) in [(PLAINLY, Stdio::from(full)), (closed, Stdio::null())] {
        let mut service = Service::start_as(script, BENCH, |command| {
            command.stderr(stderr);
        });
        service.must_report(READY);
        service.must_live_and_end();
    }
}

#[test]
fn log_without_reader_does_not_stop_daemon() {
    let mut service = Service::start_as(PLAINLY, BENCH, |command| {
        command.stderr(Stdio::piped());
    });
    service.must_report(READY);
    drop(service.daemon.process.stderr.take());
    service.daemon.signal(Signal::SIGHUP);
    service.must_live_and_end();
}

/// The worst reader: it keeps the pipe open and never reads, so every write blocks forever.
#[test]
fn a_log_that_nobody_reads_holds_nobody_up() {
    let (_reader, writer) = full_pipe();
    let mut service = Service::start_as(PLAINLY, BENCH, |command| {
        command.stderr(writer);
    });
    service.must_report(READY);
    service.must_live_and_end();
}

fn full_pipe() -> (OwnedFd, OwnedFd) {
    let (reader, writer) = nix::unistd::pipe2(OFlag::O_CLOEXEC).unwrap();
    fcntl(&writer, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).unwrap();
    while nix::unistd::write(&writer, &[0; 4096]).is_ok() {}
    fcntl(&writer, FcntlArg::F_SETFL(OFlag::empty())).unwrap();
    (reader, writer)
}

#[test]
fn too_few_descriptors_are_error_before_motion() {
    for limit in [6, 8, 10, 12, 16, 20, 24, 32, 64, 256] {
        let script = format!(r#"ulimit -n {limit}; exec "$@""#);
        let mut service = Service::start(&script, BENCH);
        assert!(!service.reports(READY, TIMEOUT), "{limit} do not serve every client");
        let status = service.daemon.wait();
        let code = status.code().filter(|code| (64..=78).contains(code));
        assert!(code.is_some(), "{limit}: {status}: {}", service.daemon.log());
        assert!(limit < 16 || service.daemon.log().contains("LimitNOFILE="), "{limit}");
    }
}

/// Waits for the first reply of the arm's motor: before it, the motor is offline and a reset is
/// refused.
fn await_the_first_reply(service: &Service) {
    let (begun, mut operator) = (Instant::now(), Operator::of(service));
    while !(operator.refresh() && operator.state.joints[0].position.is_finite()) {
        assert!(begun.elapsed() < TIMEOUT, "the motor does not answer");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Goal: a ready daemon serves as many clients as there are slots, with any soft limit.
#[test]
fn ready_daemon_has_descriptors_for_all_clients() {
    let mut service = Service::start(r#"ulimit -Sn 64; ulimit -Hn 512; exec "$@""#, BENCH);
    service.must_report(READY);
    await_the_first_reply(&service);
    let mut operators = Vec::new();
    for _ in 0..ADMINS_MAX - STOP_SLOTS {
        let mut operator = Operator::of(&service);
        operator.refresh();
        operator.ports.sleep(None, Duration::ZERO).unwrap();
        let port = (operators.len() < CONTROLLERS_MAX).then(|| operator.ports.setpoint_port().unwrap());
        assert_eq!(operator.ask(Operation::Reset).refusal, 0);
        operators.push((operator, port));
    }
    let open = fs::read_dir(format!("/proc/{}/fd", service.daemon.pid())).unwrap().count();
    println!("{open} descriptors with {} clients", operators.len());
    assert!(open < 400, "{open}");
    drop(operators);
    service.must_live_and_end();
}
