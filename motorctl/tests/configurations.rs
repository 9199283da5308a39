//! The configurations that we ship run as they are.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const PATIENCE: Duration = Duration::from_secs(30);
/// After so many cycles every motor was asked many times.
const CYCLES_MIN: u64 = 300;

fn shipped() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config");
    let mut files: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "toml"));
    files.sort();
    files
}

/// Whether a configuration needs nothing but this machine.
fn is_simulated(file: &Path) -> bool {
    let config: toml::Table = fs::read_to_string(file).unwrap().parse().unwrap();
    config["bus"].as_array().unwrap().iter().all(|bus| bus["type"].as_str() == Some("simulated"))
}

fn program(name: &str, runtime: &Path) -> Command {
    let mut command = Command::new(Path::new(env!("CARGO_BIN_EXE_motorctl")).with_file_name(name));
    command.env("MOTORD_RUNTIME_DIR", runtime).env_remove("MOTORD_INSTANCE");
    command
}

/// A daemon that does not outlive its test.
struct Daemon(Child);

impl Drop for Daemon {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _status = self.0.wait();
    }
}

/// The robot's state, as soon as a daemon tells it.
fn status(instance: &str, runtime: &Path) -> Option<Value> {
    let output = program("motorctl", runtime).args(["--instance", instance, "status", "--json"]).output();
    serde_json::from_slice(&output.unwrap().stdout).ok()
}

/// Cycles were counted, every motor answered, and no group is stopped for a cause.
fn is_well(status: &Value) -> bool {
    let all = |list: &str, is_well: fn(&Value) -> bool| status[list].as_array().unwrap().iter().all(is_well);
    status["cycle"].as_u64().unwrap() >= CYCLES_MIN
        && all("joints", |joint| joint["mode"] == "idle")
        && all("buses", |bus| bus["condition"] == "active" && bus["received"].as_u64() > Some(0))
        && all("groups", |group| group["phase"] == "disarmed")
}

/// Starts the daemon, waits until all is well, and ends it. The exit status.
fn run(file: &Path) -> Option<i32> {
    let runtime = TempDir::new().unwrap();
    let config: toml::Table = fs::read_to_string(file).unwrap().parse().unwrap();
    let instance = config["daemon"]["instance"].as_str().unwrap();
    let mut command = program("motord", runtime.path());
    let mut daemon =
        Daemon(command.args(["run", "--config"]).arg(file).stderr(Stdio::null()).spawn().unwrap());
    let begun = Instant::now();
    loop {
        let status = status(instance, runtime.path());
        if status.as_ref().is_some_and(is_well) {
            break;
        }
        assert!(begun.elapsed() < PATIENCE, "{}: {status:?}", file.display());
    }
    kill(Pid::from_raw(daemon.0.id().cast_signed()), Signal::SIGTERM).unwrap();
    daemon.0.wait().unwrap().code()
}

#[test]
fn shipped_simulated_configurations_run_until_stopped() {
    let simulated: Vec<_> = shipped().into_iter().filter(|file| is_simulated(file)).collect();
    assert!(simulated.len() >= 2, "{simulated:?}");
    for file in simulated {
        assert_eq!(run(&file), Some(0), "{}", file.display());
    }
}

/// No machine of a test has the interfaces of a robot.
#[test]
fn every_shipped_configuration_with_interfaces_passes_check() {
    let real: Vec<_> = shipped().into_iter().filter(|file| !is_simulated(file)).collect();
    assert!(real.len() >= 2, "{real:?}");
    for file in real {
        let output =
            program("motord", Path::new("/nonexistent")).arg("check").arg("--config").arg(&file).output();
        let output = output.unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{}: {said}", file.display());
    }
}

#[test]
fn a_robot_that_is_not_well_is_seen() {
    let well = serde_json::json!({
        "cycle": 300,
        "joints": [{ "mode": "idle" }],
        "buses": [{ "condition": "active", "received": 5 }],
        "groups": [{ "phase": "disarmed" }],
    });
    assert!(is_well(&well));
    for (pointer, bad) in [
        ("/cycle", Value::from(299)),
        ("/joints/0/mode", "offline".into()),
        ("/buses/0/received", 0.into()),
        ("/buses/0/condition", "down".into()),
        ("/groups/0/phase", "damping".into()),
    ] {
        let mut status = well.clone();
        *status.pointer_mut(pointer).unwrap() = bad;
        assert!(!is_well(&status), "{pointer}");
    }
}
