//! `motorctl doctor` as called by scripts. Its assessment of the test machine is not checked.

use serde_json::Value;
use std::process::{Command, Output};

fn doctor(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_motorctl")).arg("doctor").args(arguments).output().unwrap()
}

#[test]
fn exit_status_is_verdict_and_findings_have_reasons() {
    let output = doctor(&["--seconds", "0.2", "--json"]);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let is_bad = report["verdict"] == "bad";
    assert_eq!(output.status.code(), Some(i32::from(is_bad)));
    assert!(output.stderr.is_empty(), "{output:?}");
    let findings = report["findings"].as_array().unwrap();
    assert!(
        findings.iter().all(|finding| (finding["level"] == "good") == finding["why"].is_null()),
        "{report}"
    );
    // Either the latency was measured, or the daemon of another test prevented that.
    assert!(report["wake"]["wake_latency_us"]["count"].is_u64() != report["daemon"].is_u64(), "{report}");
}

#[test]
fn refused_configuration_is_finding_and_checks_continue() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("motord.toml");
    std::fs::write(&file, "[cycle]\nrate-hz = 0\n").unwrap();
    let output = doctor(&["--seconds", "0", "--config", file.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("rate-hz") && text.contains("$ motord check --config '"), "{text}");
    assert!(text.contains("kernel") && text.ends_with("verdict: bad\n"), "{text}");
}

#[test]
fn time_out_of_range_is_usage_error() {
    for seconds in ["-1", "nan", "1e9"] {
        assert_eq!(doctor(&[&format!("--seconds={seconds}")]).status.code(), Some(64), "{seconds}");
    }
}
