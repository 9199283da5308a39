//! `motorctl models`: the known motors, and the file of a vendor.

use crate::programs::program;
use crate::schemas::assert_lines_valid;
use std::fs;
use std::path::Path;
use std::process::Output;
use tempfile::TempDir;

/// The file of a vendor that motord does not bring.
const ACME: &str = include_str!("../../../motors/protocol/tests/acme.toml");

fn models(directory: &Path, arguments: &[&str]) -> Output {
    program("motorctl").current_dir(directory).arg("models").args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> &str {
    str::from_utf8(bytes).unwrap()
}

fn with_file(content: &str) -> TempDir {
    let directory = TempDir::new().unwrap();
    fs::create_dir(directory.path().join("models.d")).unwrap();
    fs::write(directory.path().join("models.d/acme.toml"), content).unwrap();
    directory
}

#[test]
fn list_has_shipped_and_own_motors() {
    let directory = with_file(ACME);
    let listed = models(directory.path(), &["--config", "robot.toml", "--json"]);
    let list = text(&listed.stdout);
    assert_lines_valid("motorctl-models", list);
    let list: serde_json::Value = serde_json::from_str(list).unwrap();
    let own: Vec<_> =
        list.as_array().unwrap().iter().filter(|vendor| vendor["is_shipped"] == false).collect();
    assert_eq!((own.len(), &own[0]["models"][0]["torque_end_nm"]), (1, &24.0.into()));
    let shown = models(directory.path(), &["--config", "robot.toml", "--show", "a-10"]);
    assert_eq!(text(&shown.stdout), ACME);
    let shown = models(directory.path(), &["--show", "RS01"]);
    assert!(text(&shown.stdout).contains("vendor = \"robstride\""));
    let unknown = models(directory.path(), &["--show", "RS99"]);
    assert_eq!(unknown.status.code(), Some(64), "{}", text(&unknown.stderr));
}

/// By hand: 45 rad/s is the code 0xFFF, zero the upper one of the two middle codes.
#[test]
fn checked_file_prints_its_frames() {
    let directory = with_file(ACME);
    let checked = models(directory.path(), &["--check", "models.d/acme.toml"]);
    let printed = text(&checked.stdout);
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stderr));
    for (frame, bytes) in [
        ("start", "FFFFFFFFFFFFFFFC"),
        ("velocity -45", "8000000000000800"),
        ("velocity 45", "8000FFF000000800"),
        ("kp 500", "8000800FFF000800"),
        ("torque 24", "8000800000000FFF"),
        ("position -12.5", "0100008008000000"),
        ("temperature of motor 127", "0180008008007F00"),
        ("fault encoder", "0180008008000004"),
    ] {
        let words = |line: &str| line.split_whitespace().collect::<Vec<_>>().join(" ");
        let has = |line: &str| words(line).contains(frame) && words(line).ends_with(bytes);
        assert!(printed.lines().any(has), "{frame} {bytes} is not in\n{printed}");
    }
    assert!(!printed.contains("clear fault"), "the motor has no such frame");
    let json = models(directory.path(), &["--check", "models.d/acme.toml", "--json"]);
    assert_lines_valid("motorctl-models", text(&json.stdout));
    let frames: Vec<serde_json::Value> = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!(frames.len(), printed.lines().count() - 2, "a line for each frame, below two lines");
    let fastest =
        frames.iter().find(|frame| frame["value"] == 45.0 && frame["direction"] == "to-motor").unwrap();
    assert_eq!((&fastest["frame"], &fastest["payload"]), (&"velocity".into(), &"8000FFF000000800".into()));
}

#[test]
fn spoiled_file_is_refused_with_place_and_cure() {
    let directory = with_file(&ACME.replace("byte = 7", "byte = 6"));
    for arguments in [["--check", "models.d/acme.toml"], ["--config", "robot.toml"]] {
        let refused = models(directory.path(), &arguments);
        assert_eq!(refused.status.code(), Some(78));
        let reason = "models.d/acme.toml:17:8: faults.byte: the fault code overlaps the temperature of motor in byte 6 of the \
                      reply; give another byte";
        assert!(text(&refused.stderr).contains(reason), "{}", text(&refused.stderr));
    }
}
