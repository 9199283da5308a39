//! The main job, end to end: 12 simulated motors at 1 kHz, moved by a controller process through shared memory.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

/// Runs a short demo, from a directory that is no checkout.
fn demo(elsewhere: &TempDir) -> Output {
    let motorctl = Path::new(env!("CARGO_BIN_EXE_motorctl"));
    let motord = motorctl.with_file_name("motord");
    assert!(motord.is_file(), "{} is missing: run `cargo build --workspace` first", motord.display());
    let mut command = Command::new(motorctl);
    command.args(["demo", "--seconds", "3", "--json"]).current_dir(elsewhere.path());
    command.output().unwrap()
}

/// Goal: a newcomer's first command shows the real thing, and shows it working.
/// Method: the demo judges itself; what it prints is judged again here, by the figures that were promised.
#[test]
fn twelve_simulated_motors_trot_at_the_promised_rate_without_a_missed_reply() {
    let elsewhere = TempDir::new().unwrap();
    let output = demo(&elsewhere);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");

    let text = String::from_utf8(output.stdout).unwrap();
    let run: Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
    let number = |value: &Value| value.as_f64().unwrap_or_else(|| panic!("{value} in {run}"));
    assert_eq!(run["motors"], 12);
    assert!((number(&run["rate_hz"]) - 1000.0).abs() <= 10.0, "{run}");
    assert_eq!(run["missed_replies"], 0, "{run}");
    assert!(number(&run["tracking_rms_rad"]) < 0.05, "{run}");
    assert!(number(&run["seconds"]) >= 3.0 && number(&run["cycles"]) >= 2900.0, "{run}");
    for latency in ["wake_latency_us", "reply_latency_us", "setpoint_age_us"] {
        let [p50, p99, p99_9, max] = ["p50", "p99", "p99_9", "max"].map(|key| number(&run[latency][key]));
        assert!(0.0 < p50 && p50 <= p99 && p99 <= p99_9 && p99_9 <= max, "{latency} in {run}");
    }
}
