//! The client against a daemon that consists of ports only.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

mod claims;
mod connection;
mod descriptors;
mod fake_daemon;
#[expect(unsafe_code, reason = "no safe crate forks")]
mod forks;
mod restarts;
mod setpoints;
mod stops;
mod threads;

use fake_daemon::Running;
use motord_client::{Client, Setpoint};
use std::path::Path;
use std::process::{Child, Command};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const INSTANCE: &str = "robot";
/// Long enough for stalls of the machine.
const TIMEOUT: Duration = Duration::from_secs(5);

fn directory() -> TempDir {
    tempfile::tempdir_in("/tmp").unwrap()
}

fn connect(directory: &TempDir) -> Client {
    let client = Client::connect_in(directory.path(), INSTANCE).unwrap();
    client.set_silence(Duration::from_millis(500));
    client
}

/// Runs the ignored test `role` of this file in a separate process.
fn spawn(role: &str, directory: &TempDir, boot_id: u64) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", role])
        .env("MOTORD_TEST_RUNTIME", directory.path())
        .env("MOTORD_TEST_BOOT_ID", boot_id.to_string())
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap()
}

fn until<T>(what: &str, mut attempt: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(done) = attempt() {
            return done;
        }
        assert!(begun.elapsed() < 4 * TIMEOUT, "{what} did not happen");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
#[ignore = "the body of a process that other tests kill"]
fn killed_controller() {
    let Some(runtime) = std::env::var_os("MOTORD_TEST_RUNTIME") else { return };
    let client = Client::connect_in(Path::new(&runtime), INSTANCE).unwrap();
    // The daemon frees the slots of dead processes within a quarter of a second after this process
    // connected.
    let mut claim = until("a free slot", || client.claim("leg").ok());
    let end = Instant::now() + 4 * TIMEOUT;
    // Runs until it is killed. The fake daemon publishes no states during its cleanup, which must
    // not end this process.
    while Instant::now() < end {
        let _silent = client.wait(TIMEOUT);
        let _ = claim.send(&[Setpoint::damping(1.0); 2]);
    }
}

#[test]
#[ignore = "the body of a process that other tests kill"]
fn killed_daemon() {
    let Some(runtime) = std::env::var_os("MOTORD_TEST_RUNTIME") else { return };
    let boot_id = std::env::var("MOTORD_TEST_BOOT_ID").unwrap().parse().unwrap();
    let _daemon = Running::start(Path::new(&runtime), boot_id);
    std::thread::sleep(Duration::from_secs(60));
}
