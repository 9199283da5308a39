//! `[[imu]]` of devices: their defaults, and what is refused.

use crate::document::{GOOD, only_error, validate, with_serial};
use motord::commands::check::{Wanted, check};
use motord_protocol::imu::SerialProtocol;
use motord_settings::imu_load::ImuLoad;
use motord_settings::plan::BusPlan;
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

// `[[imu]]` on a CAN bus: its ids, its rate and its load.

/// A robot with the buses `leg`, which has a motor with id 1, and `body`; and this IMU.
fn robot(imu: &str) -> String {
    robot_with(&["GIM8108-8"], imu)
}

/// The same with motors of these models, whose ids begin at 1.
fn robot_with(models: &[&str], imu: &str) -> String {
    let motor = |(index, model): (usize, &&str)| {
        let id = index + 1;
        format!(
            "[[motor]]\nname = 'm{id}'\nbus = 'leg'\nid = {id}\nprotocol = 'mit'\nmodel = '{model}'\n[motor.limits]\n\
             position-rad = [-1, 1]\nvelocity-rad-s = 5\ntorque-nm = 5\ntorque-slew-nm-per-s = 50\n"
        )
    };
    let motors: String = models.iter().enumerate().map(motor).collect();
    format!(
        "[[bus]]\nname = 'leg'\ntype = 'simulated'\n[[bus]]\nname = 'body'\ntype = 'simulated'\n\
         [[bus]]\nname = 'arm'\ntype = 'serial'\ndevice = '/dev/null'\n{motors}[[imu]]\nname = 'base'\n{imu}\n"
    )
}

fn error(imu: &str) -> String {
    validate(&robot(imu)).expect_err(imu).to_string()
}

#[test]
fn can_imus_have_vendor_ids_by_default() {
    let device = |imu: &str| {
        let settings = validate(&robot(imu)).unwrap().settings;
        let can = settings.sensors.imus[0].source.can().unwrap();
        (can.bus, can.device.sent_ids().collect::<Vec<_>>(), can.device.request_id())
    };
    let (bus, sent, request) = device("type = 'hipnuc-can'\nbus = 'body'");
    assert_eq!((bus, sent, request), (1, vec![0x188, 0x288, 0x388, 0x488, 0x708], None));
    let (_, sent, request) = device("type = 'damiao'\nbus = 'body'");
    assert_eq!((sent[0], request), (0x11, Some(1)));
    let (_, _, request) = device("type = 'damiao'\nbus = 'body'\nfirmware = 1022");
    assert_eq!(request, Some(0x6FF));
}

#[test]
fn location_of_can_imu_is_checked() {
    for (imu, expected) in [
        ("type = 'hipnuc-can'", "imu.bus: is missing; name the [[bus]] the IMU is on"),
        (
            "type = 'damiao'\nbus = 'boddy'",
            "robot.toml:25:7: imu.bus: there is no bus \"boddy\"; did you mean `body`?",
        ),
        (
            "type = 'damiao'\nbus = 'arm'",
            "imu.bus: \"arm\" is a serial bus, and this IMU speaks over CAN only",
        ),
        (
            "type = 'damiao'\nbus = 'body'\nnode-id = 8",
            "imu.node-id: does not belong to an IMU of type `damiao`",
        ),
        ("type = 'hipnuc-can'\nbus = 'body'\nnode-id = 128", "imu.node-id: 128 is out of range"),
        ("type = 'simulated'\nbus = 'body'", "imu.bus: does not belong to an IMU of type `simulated`"),
    ] {
        let error = error(imu);
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn colliding_ids_of_imus_are_refused() {
    let second = "\n[[imu]]\nname = 'two'\n";
    for (imu, expected) in [
        (
            "type = 'damiao'\nbus = 'leg'",
            "imu.can-id: the id 0x001 that follows from it is that of commands to the motor \"m1\"",
        ),
        ("type = 'damiao'\nbus = 'leg'\ncan-id = 0x101", "is that of the replies of the motor \"m1\""),
        (
            "type = 'damiao'\nbus = 'leg'\ncan-id = 9\nmaster-id = 9",
            "is that of the requests to it on the same bus",
        ),
        (
            &format!("type = 'hipnuc-can'\nbus = 'body'{second}type = 'hipnuc-can'\nbus = 'body'"),
            "imu.node-id: the id 0x188 that follows from it is that of the IMU \"base\" on the same bus, and only one node may send an id; \
             give another node-id, here and on the device",
        ),
        (
            &format!("type = 'damiao'\nbus = 'body'{second}type = 'damiao'\nbus = 'body'\nmaster-id = 18"),
            "imu.can-id: the id 0x001 that follows from it is that of the IMU \"base\"",
        ),
    ] {
        let error = error(imu);
        assert!(error.contains(expected), "{error}");
    }
    let shared = "type = 'damiao'\nbus = 'body'\nfirmware = 1022\nrate-hz = 100\n";
    let two = |ids: &str| {
        validate(&format!("[cycle]\nrate-hz = 500\n{}", robot(&format!("{shared}{second}{shared}{ids}"))))
    };
    assert!(two("can-id = 2\nmaster-id = 18").is_ok());
    assert!(two("master-id = 18").is_err(), "one device twice");
}

/// A Damiao motor 1 reads other modes at 0x101, 0x201 and 0x301, and replies at 0x11 by default.
#[test]
fn imu_never_sends_what_motors_obey() {
    for (ids, expected) in [
        (
            "can-id = 0x201",
            "imu.can-id: the id 0x201 that follows from it is that of commands to the motor \"m1\"",
        ),
        (
            "can-id = 9",
            "imu.master-id: the id 0x011 that follows from it is that of the replies of the motor \"m1\"",
        ),
    ] {
        let master = if ids.contains('9') { "" } else { "master-id = 18" };
        let text = robot_with(&["DM-J4310-2EC"], &format!("type = 'damiao'\nbus = 'leg'\n{ids}\n{master}"));
        let error = validate(&text).expect_err(ids).to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn rates_of_devices_are_checked() {
    let hipnuc =
        |rate: f64| validate(&robot(&format!("type = 'hipnuc-can'\nbus = 'body'\nrate-hz = {rate}")));
    for rate in [10.0, 100.0, 166.7, 200.0] {
        assert!(hipnuc(rate).is_ok(), "{rate}");
    }
    for (rate, nearest) in [(500.0, "200 Hz"), (5.0, "10 Hz"), (150.0, "142.9 Hz")] {
        let error = hipnuc(rate).expect_err("is no rate").to_string();
        assert!(
            error.contains("imu.rate-hz: the device sends 10 to 200") && error.contains(nearest),
            "{error}"
        );
    }
    let damiao = |rate: f64| validate(&robot(&format!("type = 'damiao'\nbus = 'body'\nrate-hz = {rate}")));
    for rate in [1000.0, 500.0, 333.3, 200.0] {
        assert!(damiao(rate).is_ok(), "{rate}");
    }
    let error = damiao(700.0).expect_err("is no part of 1000 Hz").to_string();
    assert!(error.contains("the nearest rate is 1000 Hz"), "{error}");
}

/// At 1 Mbit/s. Expected bits: 129 of 8 bytes, 110 of 6; every stuffing bit: 135 and 115.
#[test]
fn plan_counts_frames_of_imus() {
    let plan = |models: &[&str], imu: &str| {
        let settings = validate(&robot_with(models, imu)).unwrap().settings;
        (
            BusPlan::of(&settings).swap_remove(usize::from(imu.contains("body"))),
            ImuLoad::of(&settings, &settings.sensors.imus[0]).unwrap(),
        )
    };
    let (bus, imu) = plan(&["GIM8108-8"], "type = 'hipnuc-can'\nbus = 'leg'\nrate-hz = 200");
    assert_eq!(imu.frames_per_second, 800.0);
    let worst = 200.0 * (3.0 * 115.0 + 135.0) / 1e6;
    assert!((imu.utilisation - worst).abs() < 1e-9, "{imu:?}");
    assert!((bus.worst_case_utilisation - (0.25 + worst)).abs() < 1e-9, "{bus:?}");
    // A frame before the command, and one before the reply.
    assert_eq!(bus.last_reply.as_micros(), 20 + 129 + 50 + 110 + 2 * 129);
    let (bus, imu) = plan(&["GIM8108-8"], "type = 'damiao'\nbus = 'body'\nrate-hz = 500");
    assert_eq!((imu.frames_per_second, bus.motors), (3000.0, 0));
    assert_eq!(bus.last_reply.as_micros(), 20 + 6 * 129);
    assert_eq!(bus.rate_hz_max.floor(), 1007.0);
}

#[test]
fn imu_that_delays_last_reply_is_refused() {
    let text = robot_with(&["GIM8108-8"; 3], "type = 'hipnuc-can'\nbus = 'leg'");
    let error = validate(&text).expect_err("a reply is late").to_string();
    assert!(error.contains("imu.bus: the frames of the IMU delay the last reply to 866 µs"), "{error}");
    assert!(error.contains("give it another bus, or lower cycle.rate-hz to at most 923 Hz"), "{error}");
    assert!(!error.contains("bus: the last reply"), "{error}");
    let slow = text.replace("[[bus]]\nname = 'leg'", "[cycle]\nrate-hz = 900\n[[bus]]\nname = 'leg'");
    assert!(validate(&slow).is_ok());
}

#[test]
fn bus_that_imus_fill_is_refused() {
    let bus = "type = 'simulated'\nbitrate = 50000";
    let text = robot("type = 'hipnuc-can'\nbus = 'body'\nrate-hz = 200");
    let slow = text.replace("name = 'body'\ntype = 'simulated'", &format!("name = 'body'\n{bus}"));
    let error = validate(&slow).expect_err("192 %").to_string();
    assert!(error.contains("imu.bus: with the IMU the bus needs 192.0 % of its time at worst"), "{error}");
}
