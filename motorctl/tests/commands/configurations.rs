//! The shipped configurations run unchanged.

use motord_harness::daemon::Daemon;
use motord_harness::programs::program;
use nix::sys::signal::Signal;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// Number of cycles after which every motor was polled many times.
const CYCLES_MIN: u64 = 300;

fn shipped() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config");
    let mut files: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "toml"));
    files.sort();
    files
}

/// Returns `true` if a configuration needs only this machine.
fn is_simulated(file: &Path) -> bool {
    let config: toml::Table = fs::read_to_string(file).unwrap().parse().unwrap();
    config["bus"].as_array().unwrap().iter().all(|bus| bus["type"].as_str() == Some("simulated"))
}

/// Returns `true` if cycles were counted, every motor answered, and no group is stopped for a
/// cause.
fn is_well(status: &Value) -> bool {
    let all = |list: &str, is_well: fn(&Value) -> bool| status[list].as_array().unwrap().iter().all(is_well);
    status["cycle"].as_u64().unwrap() >= CYCLES_MIN
        && all("joints", |joint| joint["mode"] == "idle")
        && all("buses", |bus| bus["condition"] == "active" && bus["received"].as_u64() > Some(0))
        && all("groups", |group| group["phase"] == "disarmed")
}

/// Starts a daemon, waits until it is healthy, ends it, and returns the exit status.
fn run(file: &Path) -> Option<i32> {
    let mut daemon = Daemon::start(&fs::read_to_string(file).unwrap());
    daemon.await_status(|status| !status.is_null() && is_well(status));
    daemon.signal(Signal::SIGTERM);
    daemon.process.wait().unwrap().code()
}

#[test]
fn shipped_simulated_configurations_run_until_stopped() {
    let simulated: Vec<_> = shipped().into_iter().filter(|file| is_simulated(file)).collect();
    assert!(simulated.len() >= 2, "{simulated:?}");
    for file in simulated {
        assert_eq!(run(&file), Some(0), "{}", file.display());
    }
}

/// Test machines do not have the interfaces of a robot.
#[test]
fn every_shipped_configuration_with_interfaces_passes_check() {
    let real: Vec<_> = shipped().into_iter().filter(|file| !is_simulated(file)).collect();
    assert!(real.len() >= 2, "{real:?}");
    for file in real {
        let output = program("motord").arg("check").arg("--config").arg(&file).output();
        let output = output.unwrap();
        let printed = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{}: {printed}", file.display());
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
