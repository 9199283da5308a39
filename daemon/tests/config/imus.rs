//! `[[imu]]` of devices: their defaults, and what is refused.

use crate::document::{GOOD, only_error, validate, with_serial};
use motord::commands::check::{Wanted, check};
use motord_protocol::imu::SerialProtocol;
use motord_settings::sensor::imu::{ImuSerial, ImuSettings, WhenLost};
use std::time::Duration;

/// A robot with an IMU of these lines.
fn with_imu(lines: &str) -> String {
    format!("{GOOD}[[imu]]\nname = 'base'\n{lines}\n")
}

fn imu(lines: &str) -> ImuSettings {
    let mut settings = validate(&with_imu(lines)).expect("it is good").settings;
    settings.sensors.imus.remove(0)
}

#[test]
fn serial_imu_has_defaults_of_its_vendor() {
    for (word, protocol) in [("hipnuc-serial", SerialProtocol::Hipnuc), ("xsens", SerialProtocol::Xsens)] {
        let imu = imu(&format!("type = '{word}'\ndevice = '/dev/null'"));
        let expected = ImuSerial { protocol, device: "/dev/null".into(), baud: 115_200 };
        assert_eq!(imu.source.serial(), Some(&expected));
        assert_eq!(
            (imu.rate_hz, imu.lost_after, imu.when_lost),
            (100.0, Duration::from_millis(30), WhenLost::Report)
        );
    }
    assert!((imu("type = 'simulated'").rate_hz - 200.0).abs() < 1e-9);
}

#[test]
fn imu_that_cannot_work_is_refused() {
    let cases = [
        ("type = 'hipnuc-serial'", "imu.device: is missing; give the serial device"),
        ("type = 'xsens'\ndevice = 'ttyUSB0'", "imu.device: \"ttyUSB0\" is no absolute path"),
        (
            "type = 'hipnuc-serial'\ndevice = '/dev/null'\nbaud = 230400",
            "imu.baud: 230400 bit/s is no rate of this device; give one of 115200, 460800, 921600",
        ),
        (
            "type = 'hipnuc-serial'\ndevice = '/dev/null'\nrate-hz = 200",
            "imu.rate-hz: 200 samples per second of 82 bytes need 164000 bit/s, and the line has 115200; at most 140 Hz",
        ),
        (
            "type = 'xsens'\ndevice = '/dev/null'\nrate-hz = 400",
            "imu.rate-hz: 400 samples per second of 54 bytes need 216000 bit/s, and the line has 115200; at most 213 Hz",
        ),
        (
            "type = 'xsens'\ndevice = '/dev/null'\nlost-after-ms = 19",
            "imu.lost-after-ms: 19 ms is less than 2 samples of 10 ms; give it at least 20 ms",
        ),
        (
            "type = 'simulated'\ndevice = '/dev/null'",
            "imu.device: does not belong to an IMU of type `simulated`",
        ),
        (
            "type = 'xsens'\ndevice = '/dev/null'\nsimulation = { noise-rad-s = 0.1 }",
            "imu.simulation.noise-rad-s: does not belong to an IMU of type `xsens`",
        ),
    ];
    for (lines, expected) in cases {
        let error = only_error(&with_imu(lines));
        assert!(error.contains(expected), "{error}\nexpected {expected}");
    }
    let fastest = "type = 'hipnuc-serial'\ndevice = '/dev/null'\nbaud = 921600\nrate-hz = 1000";
    assert!((imu(fastest).source.serial().unwrap().utilisation(1000.0) - 0.89).abs() < 0.01);
}

/// A device has other names too: `/dev/./null` stands for a link in `/dev/serial/by-id`.
#[test]
fn serial_line_of_another_owner_is_refused() {
    let second = |device: &str| format!("[[imu]]\nname = 'head'\ntype = 'xsens'\ndevice = '{device}'\n");
    let first = with_imu("type = 'hipnuc-serial'\ndevice = '/dev/zero'");
    for device in ["/dev/zero", "/dev/./zero"] {
        let error = only_error(&format!("{first}{}", second(device)));
        assert!(error.contains(&format!("{device:?} is used by IMU \"base\" already")), "{error}");
    }
    let error = only_error(&format!("{}{}", with_serial(), second("/dev/./null")));
    assert!(error.contains("\"/dev/./null\" is used by bus \"gripper\" already"), "{error}");
    assert!(validate(&format!("{first}{}", second("/dev/full"))).is_ok());
}

#[test]
fn check_tells_cost_of_serial_imu() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("robot.toml");
    let config = with_imu("type = 'hipnuc-serial'\ndevice = '/dev/null'\nbaud = 921600\nrate-hz = 500");
    std::fs::write(&file, config).unwrap();
    let printed = |json| {
        let mut out = Vec::new();
        assert_eq!(check(&file, Wanted { json, joints: false }, &mut out).unwrap(), 0);
        String::from_utf8(out).unwrap()
    };
    let text = printed(false);
    let row = text.lines().find(|line| line.starts_with("base")).unwrap();
    assert_eq!(
        row.split_whitespace().collect::<Vec<_>>().join(" "),
        "base hipnuc-serial 500 Hz 41000 bytes/s 44.5 % 1123 Hz /dev/null at 921600 baud"
    );
    let report: serde_json::Value = serde_json::from_str(&printed(true)).unwrap();
    assert_eq!(report["imus"][0]["line"]["bytes_per_second"], 41_000.0);
}
