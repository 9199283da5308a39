//! `motorctl frame decode` of the logs of other tools.

use crate::frame::{ROBOT, frame, objects, text};
use crate::schemas::assert_lines_valid;
use serde_json::{Value, json};
use std::process::Output;

/// A question for faults of fl-hip and its answer, as each tool logs them.
const LOGS: [(&str, &str); 6] = [
    ("candump.log", "  vcan0  001   [8]  FF FF FF FF FF FF 00 FB\n  vcan0  101   [6]  01 02 00 00 00 00\n"),
    (
        "absolute.log",
        " (1436509052.249713)  vcan0  001   [8]  FF FF FF FF FF FF 00 FB\n (1436509052.25)  vcan0  101   [6]  01 02 00 00 00 00\n",
    ),
    (
        "dated.log",
        " (2015-07-10 06:17:32.249713)  vcan0  001   [8]  FF FF FF FF FF FF 00 FB   '........'\n\
         \u{20}(2015-07-10 06:17:32.250000)  vcan0  101   [6]  01 02 00 00 00 00\n",
    ),
    (
        "short.log",
        "(1436509052.249713) vcan0 001#FFFFFFFFFFFF00FB\n(1436509052.25) vcan0 101#010200000000 R\n",
    ),
    (
        "vector.asc",
        "date Fre Jul 10 06:17:32.000 2015\nbase hex  timestamps absolute\n   0.249713 1  1  Tx   d 8 FF FF FF FF FF FF 00 FB\n\
         \u{20}  0.250000 1  101             Rx   d 6 01 02 00 00 00 00\nEnd TriggerBlock\n",
    ),
    (
        "peak.trc",
        ";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n      1       249.713 DT 1      0001 Tx -  8    FF FF FF FF FF FF 00 FB\n\
         \u{20}     2       250.000 DT 1      0101 Rx -  6    01 02 00 00 00 00\n",
    ),
];

/// Writes `files` and the configuration, and decodes each file by its name.
fn decode_files(files: &[(&str, &str)]) -> Output {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("robot.toml"), ROBOT).unwrap();
    let names = files.iter().map(|(name, text)| {
        std::fs::write(path(name), text).unwrap();
        path(name)
    });
    let arguments: Vec<_> =
        ["--json".into(), "--config".into(), path("robot.toml")].into_iter().chain(names).collect();
    frame("decode", &arguments.iter().map(String::as_str).collect::<Vec<_>>(), "")
}

#[test]
fn logs_of_every_tool_are_read_by_name() {
    let output = decode_files(&LOGS);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let objects = objects(&output);
    assert_eq!(objects.len(), 2 * LOGS.len(), "{output:?}");
    let expected = [
        [Value::Null, Value::Null],
        [json!(1436509052.249713), json!(1436509052.25)],
        [json!(1436509052.249713), json!(1436509052.25)],
        [json!(1436509052.249713), json!(1436509052.25)],
        [json!(0.249713), json!(0.25)],
        [json!(0.249713), json!(0.25)],
    ];
    for ((pair, times), (name, _)) in objects.chunks(2).zip(expected).zip(LOGS) {
        for ((object, time), kind) in pair.iter().zip(times).zip(["get_fault", "fault_reply"]) {
            let found = [&object["kind"], &object["motor"], &object["interface"], &object["time"]];
            assert_eq!(found, [&json!(kind), &json!("fl-hip"), &json!("vcan0"), &time], "{name}: {object}");
            assert_lines_valid("motorctl-frame-decode", &object.to_string());
        }
    }
}

#[test]
fn special_frames_are_named_with_line_and_time() {
    let log = " (0.1)  vcan0  20000040   [8]  00 00 00 00 00 00 00 00   ERRORFRAME\n\
        \tbus-off\n\
        \u{20}(0.2)  vcan0  20000004   [8]  00 20 00 00 00 00 00 00   ERRORFRAME\n\
        \u{20}(0.3)  vcan0  001  [08]  FF FF FF FF FF FF FF FC\n\
        \u{20}(0.4)  vcan0  001   [0]  remote request\n\
        \u{20}(0.5)  vcan0  00000001   [1]  00\n\
        \u{20}(0.6)  vcan0  001   [8]  FF FF FF FF FF FF FF FC\n";
    let output = decode_files(&[("special.log", log)]);
    assert_eq!(output.status.code(), Some(65), "{output:?}");
    let objects = objects(&output);
    let expected = [
        (1, 0.1, "bus off"),
        (3, 0.2, "error frame: the controller is error passive"),
        (4, 0.3, "CAN FD frame with the id 001"),
        (5, 0.4, "remote frame"),
        (6, 0.5, "frame with the 29-bit id 00000001"),
    ];
    for (object, (line, time, reason)) in objects.iter().zip(expected) {
        assert_lines_valid("motorctl-frame-decode", &object.to_string());
        assert_eq!((&object["line"], &object["time"]), (&json!(line), &json!(time)), "{object}");
        assert!(object["reason"].as_str().unwrap().starts_with(reason), "{object}");
        assert!(object["file"].as_str().unwrap().ends_with("special.log"), "{object}");
    }
    assert_eq!((objects.len(), &objects[5]["kind"]), (6, &json!("start_motor")), "{output:?}");
}

#[test]
fn log_without_names_follows_its_channels() {
    let log = ";\n1) 1.0 2 Rx 0001 - 8 FF FF FF FF FF FF FF FC\n";
    let output = decode_files(&[("second.trc", log)]);
    assert!(text(&output).contains("channel 2 has no interface in the configuration"), "{output:?}");
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("robot.toml"), ROBOT).unwrap();
    std::fs::write(path("second.trc"), log).unwrap();
    let arguments = ["--config", &path("robot.toml"), "--interface", "vcan0", &path("second.trc")];
    let output = frame("decode", &arguments, "");
    assert!(output.status.success() && text(&output).contains("\"start_motor\""), "{output:?}");
}
