//! The memory of a running daemon.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// Twelve motors on four simulated buses.
const CONFIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../config/quadruped-simulated.toml");
/// Resident memory of a daemon with twelve motors, KiB. All of its memory is locked where the system permits it.
const RESIDENT_MAX: u64 = 32 * 1024;

/// Starts the daemon in `place`, and returns it once it is ready.
fn start(place: &Path) -> Child {
    let mut daemon = Command::new(env!("CARGO_BIN_EXE_motord"))
        .args(["run", "--config", CONFIG])
        .env("MOTORD_RUNTIME_DIR", place)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(daemon.stderr.take().unwrap()).lines().map_while(Result::ok);
    assert!(lines.any(|line| line.contains(" ready ")), "it starts");
    // The pipe is read on, so that the daemon can write its log.
    std::thread::spawn(move || lines.for_each(drop));
    daemon
}

/// A value of `/proc/<pid>/status`, KiB.
fn status(pid: u32, key: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with(key)).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
fn resident_memory_stays_within_budget() {
    let place = tempfile::tempdir().unwrap();
    let mut daemon = start(place.path());
    std::thread::sleep(std::time::Duration::from_secs(1));
    let [resident, locked] = ["VmRSS", "VmLck"].map(|key| status(daemon.id(), key));
    kill(Pid::from_raw(daemon.id().cast_signed()), Signal::SIGTERM).unwrap();
    assert!(daemon.wait().unwrap().success());
    println!("resident: {resident} KiB, locked: {}", locked > 0);
    assert!(resident <= RESIDENT_MAX, "{resident} KiB");
}
