//! The memory of a running daemon, and its thread that serves the metrics.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

use motord_harness::daemon::{Daemon, quadruped, until};
use motord_harness::programs::lacks;
use motord_shared::CycleRecord;
use std::io::Write;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::Duration;
use tempfile::TempDir;

/// Resident memory of a daemon with twelve motors, KiB. All of its memory is locked where the
/// system permits it.
const RESIDENT_MAX: u64 = 23 * 1024;
/// Memory that a daemon needs for a recorder, at least, KiB.
const RECORDER_LEAST: u64 = 3 * 1024;
/// A field of proc_pid_stat(5).
const SCHEDULING_POLICY: usize = 41;
const SCHED_OTHER: u32 = 0;

/// Returns a daemon with twelve motors on four simulated buses, once it is ready.
fn start(metrics: SocketAddr) -> Daemon {
    let daemon = Daemon::start(&format!("{}\n[telemetry]\nprometheus-listen = '{metrics}'\n", quadruped()));
    daemon.await_log(" ready ");
    daemon
}

/// A value of `/proc/<pid>/status`, KiB.
fn status(pid: u32, key: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with(key)).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

/// A field of the thread `name` in `/proc/<pid>/task/<tid>/stat`, counted from 1.
fn stat(pid: u32, name: &str, field: usize) -> u32 {
    let tasks = std::fs::read_dir(format!("/proc/{pid}/task")).unwrap();
    let stats = tasks.map(|task| std::fs::read_to_string(task.unwrap().path().join("stat")).unwrap());
    let stat = stats.into_iter().find(|stat| stat.contains(&format!("({name})"))).unwrap();
    // The name is the second field.
    let after_name = stat.rsplit(')').next().unwrap();
    after_name.split_whitespace().nth(field - 3).unwrap().parse().unwrap()
}

#[test]
fn resident_memory_stays_within_budget() {
    let metrics = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut daemon = start(metrics);
    std::thread::sleep(Duration::from_secs(1));
    // Each holds a buffer of the server.
    let clients: Vec<_> = (0..64).map(|_| TcpStream::connect(metrics).unwrap()).collect();
    for mut client in &clients {
        let _closed = client.write_all(b"GET /metrics HTTP/1.1\r\nHost: ");
    }
    std::thread::sleep(Duration::from_secs(1));
    assert_eq!(stat(daemon.process.id(), "motord-http", SCHEDULING_POLICY), SCHED_OTHER);
    let [resident, locked] = ["VmRSS", "VmLck"].map(|key| status(daemon.process.id(), key));
    assert!(daemon.end().success());
    println!("resident: {resident} KiB, locked: {}", locked > 0);
    assert!(resident <= RESIDENT_MAX, "{resident} KiB");
}

#[test]
fn memory_for_recorder_lasts_as_long_as_recorder() {
    let mut daemon = Daemon::start(&quadruped());
    daemon.await_log(" ready ");
    let pid = daemon.process.id();
    let client = daemon.connect();
    std::thread::sleep(Duration::from_secs(1));
    let resident = || status(pid, "VmRSS");
    let before = resident();
    for _ in 0..2 {
        let mut records = client.records().unwrap();
        let mut record = CycleRecord::default();
        until("a record", || records.take(&mut record).unwrap().then_some(()));
        assert!(resident() > before + RECORDER_LEAST);
        drop(records);
        until("less memory", || (resident() < before + RECORDER_LEAST / 2).then_some(()));
    }
    assert!(daemon.end().success());
}

/// Goal: the advice after a refusal of `SCHED_FIFO` is not circular.
/// Method: the daemon starts without the capability, and with a limit of 0.
#[test]
fn daemon_names_missing_capability() {
    const WITHOUT_RIGHT: &str = r#"
        [ "$(id -u)" = 0 ] || exec prlimit --rtprio=0:0 "$@"
        exec setpriv --bounding-set=-sys_nice --inh-caps=-sys_nice prlimit --rtprio=0:0 "$@""#;
    if lacks(&["prlimit", "setpriv"]) {
        return;
    }
    let directory = TempDir::new().unwrap();
    let mut daemon = Daemon::start_by(WITHOUT_RIGHT, directory, &quadruped(), |_| {});
    daemon.await_log(" ready ");
    daemon.end();
    let log = daemon.log();
    let refusal = log.lines().find(|line| line.contains("SCHED_FIFO: no"));
    let is_root = nix::unistd::geteuid().is_root();
    let reason = if is_root { "root has no CAP_SYS_NICE" } else { "RLIMIT_RTPRIO is 0" };
    assert!(refusal.is_some_and(|line| line.contains(reason) && line.contains("The remedy: ")), "{log}");
}
