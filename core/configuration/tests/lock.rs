//! The lock file: what a motor said is held against its configuration, value by value.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_configuration::lock::{Lock, Verdict, end_findings, end_lines, findings, mismatches};
use motord_configuration::{Machine, parse};
use motord_protocol::commissioning::{ReportedMotor, ReportedProtocol};
use motord_settings::settings::Settings;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;

/// `elbow`: GIM8108-36, rotor 0.154 N·m/A, ratio 36, 21 pole pairs.
const ROBOT: &str = "
[[bus]]
name = 'arm'
type = 'socketcan'
interface = 'can0'
[[motor]]
name = 'elbow'
bus = 'arm'
id = 2
protocol = 'gim'
model = 'GIM8108-36'
[[motor]]
name = 'hip'
bus = 'arm'
id = 3
protocol = 'mit'
model = 'GIM8108-8'
[[motor]]
name = 'foot'
bus = 'arm'
id = 4
host-id = 0x14
protocol = 'mit'
model = 'DM-J4310-2EC'
";

fn settings() -> Settings {
    parse(Path::new("robot.toml"), ROBOT.as_bytes(), &Machine::here()).unwrap().settings
}

/// The elbow, as it should report itself.
fn elbow() -> ReportedMotor {
    let values = [("torque-constant", 0.154), ("gear-ratio", 36.0), ("pole-pairs", 21.0)];
    ReportedMotor {
        name: "elbow".into(),
        bus: "arm".into(),
        id: 2,
        host_id: Some(0x102),
        protocol: ReportedProtocol::Gim,
        firmware: Some(7),
        values: values.map(|(name, value)| (name.to_owned(), value)).into(),
    }
}

fn differing(change: impl FnOnce(&mut ReportedMotor)) -> Vec<String> {
    let mut motor = elbow();
    change(&mut motor);
    mismatches(&settings(), &Lock::new(vec![motor])).iter().map(ToString::to_string).collect()
}

#[test]
fn motor_that_reports_its_configuration_is_no_mismatch() {
    assert!(differing(|_| {}).is_empty());
    assert!(differing(|motor| *motor.values.get_mut("torque-constant").unwrap() *= 1.04).is_empty());
}

#[test]
fn every_difference_names_motor_value_and_cure() {
    type Change = fn(&mut ReportedMotor);
    let cases: [(Change, &str, &str); 6] = [
        (
            |motor| *motor.values.get_mut("torque-constant").unwrap() = 0.5,
            "elbow: torque-constant is 0.5 in the motor, 0.154 in the configuration",
            "motorctl config set torque-constant 0.154 --bus can0 --id 2",
        ),
        (|motor| *motor.values.get_mut("gear-ratio").unwrap() = 8.0, "gear-ratio is 8", "gear-ratio = 8"),
        (|motor| *motor.values.get_mut("pole-pairs").unwrap() = 14.0, "pole-pairs is 14", "model"),
        (|motor| motor.id = 1, "id is 1", "motorctl setup"),
        (|motor| motor.host_id = Some(0x101), "host-id is 0x101", "host-id = 0x101"),
        (
            |motor| motor.protocol = ReportedProtocol::Mit,
            "protocol is mit",
            "motorctl protocol gim --bus can0 --id 2",
        ),
    ];
    for (change, complaint, cure) in cases {
        let answer = differing(change);
        assert!(
            answer.iter().any(|line| line.contains(complaint) && line.contains(cure)),
            "{complaint}: {answer:?}"
        );
    }
}

/// A serial frame has one byte for the host id.
#[test]
fn line_is_proposed_no_long_host_id() {
    let settings = settings();
    let motor = settings.motors.iter().find(|motor| motor.name == "elbow").unwrap();
    let cure = |bus: &str| {
        let reported = ReportedMotor { bus: bus.into(), host_id: Some(0x102), ..elbow() };
        let mut settings = settings.clone();
        settings.buses[motor.bus].kind = if bus.starts_with('/') {
            let turnaround = std::time::Duration::ZERO;
            motord_bus::transport::Serial { device: bus.into(), baud: 921_600, turnaround }.into()
        } else {
            settings.buses[motor.bus].kind.clone()
        };
        let findings = motord_configuration::lock::findings(&settings, motor, Some(&reported));
        findings.into_iter().find(|finding| finding.value == "host-id").unwrap().cure
    };
    assert!(cure("can0").contains("host-id = 0x102"), "{}", cure("can0"));
    let line = cure("/dev/ttyUSB0");
    assert!(!line.contains("0x102") && line.contains("host-id"), "{line}");
}

#[test]
fn a_motor_of_another_family_is_named() {
    let settings = settings();
    for (name, id, host_id, reported, agrees) in [
        ("hip", 3, 0x103, ReportedProtocol::Mit, true),
        ("hip", 3, 0x103, ReportedProtocol::OtherMit, false),
        ("hip", 3, 0x103, ReportedProtocol::Gim, false),
        ("foot", 4, 0x14, ReportedProtocol::OtherMit, true),
        ("foot", 4, 0x14, ReportedProtocol::Mit, false),
    ] {
        let motor = ReportedMotor {
            name: name.into(),
            id,
            host_id: Some(host_id),
            protocol: reported,
            values: [].into(),
            ..elbow()
        };
        assert_eq!(mismatches(&settings, &Lock::new(vec![motor])).is_empty(), agrees, "{name} {reported:?}");
    }
}

#[test]
fn unreadable_value_is_unknown_not_agreed() {
    let settings = settings();
    let hip = settings.motors.iter().find(|motor| motor.name == "hip").unwrap();
    let answer = ReportedMotor {
        name: "hip".into(),
        id: 3,
        host_id: Some(0x103),
        protocol: ReportedProtocol::Mit,
        values: [].into(),
        ..elbow()
    };
    let verdict = |value: &str, reported: Option<&ReportedMotor>| {
        findings(&settings, hip, reported).iter().find(|finding| finding.value == value).unwrap().verdict
    };
    for value in ["torque-constant", "gear-ratio", "pole-pairs"] {
        assert_eq!(verdict(value, Some(&answer)), Verdict::Unknown, "{value}");
    }
    assert_eq!(verdict("answer", None), Verdict::Unknown);
}

#[test]
fn lock_round_trips_and_other_file_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let config = directory.path().join("robot.toml");
    assert_eq!(Lock::load(&config).unwrap(), None);
    let lock = Lock::new(vec![elbow()]);
    let file = lock.save(&config).unwrap();
    assert_eq!(file, directory.path().join("robot.lock.toml"));
    assert_eq!(Lock::load(&config).unwrap(), Some(lock));
    for text in ["form = 2\n", "form = 1\nmotors = 3\n", "[[motor", "\u{1}"] {
        fs::write(&file, text).unwrap();
        let complaint = Lock::load(&config).unwrap_err().to_string();
        assert!(complaint.contains("motorctl setup"), "{text:?}: {complaint}");
    }
    fs::remove_file(&file).unwrap();
    fs::create_dir(&file).unwrap();
    assert!(Lock::load(&config).is_err());
}

/// Goal: a lock that cannot be reached is not taken for a robot without a lock, and saving follows
/// no link.
#[test]
fn link_without_target_is_no_missing_lock() {
    let directory = tempfile::tempdir().unwrap();
    let config = directory.path().join("robot.toml");
    let (file, elsewhere) = (Lock::path(&config), directory.path().join("elsewhere"));
    symlink(&elsewhere, &file).unwrap();
    let complaint = Lock::load(&config).unwrap_err().to_string();
    assert!(complaint.contains("robot.lock.toml: cannot be read"), "{complaint}");
    fs::write(&elsewhere, "kept").unwrap();
    symlink(&elsewhere, directory.path().join("robot.lock.toml.new")).unwrap();
    Lock::new(vec![elbow()]).save(&config).unwrap();
    assert_eq!(fs::read_to_string(&elsewhere).unwrap(), "kept");
    assert!(fs::symlink_metadata(&file).unwrap().is_file());
}

#[test]
fn motor_with_other_ends_is_named() {
    let settings = settings();
    let foot = settings.motors.iter().find(|motor| motor.name == "foot").unwrap();
    let differing = |ends| {
        let differs =
            end_findings(foot, ends).into_iter().filter(|finding| finding.verdict == Verdict::Differs);
        differs.map(|finding| finding.to_string()).collect::<Vec<_>>()
    };
    assert_eq!(differing([12.5, 30.0, 10.0]), [""; 0]);
    assert_eq!(differing([12.5, 50.0, 20.0]), [""; 0], "the ends of the motor are used");
    // The default limit of the velocity is the model's 20.9 rad/s.
    let other = differing([12.5, 20.0, 10.0]);
    assert_eq!(other.len(), 1);
    assert!(
        other[0].contains("VMAX is 20.0 in the motor, at least 21.005 by the limits in the configuration")
            && other[0].contains("register 22"),
        "{other:?}"
    );
    assert_eq!(differing([f32::NAN, f32::INFINITY, -10.0]).len(), 3);
}

#[test]
fn written_ends_must_be_those_of_the_motor() {
    let text = ROBOT.to_owned() + "velocity-end-rad-s = 50.0\n";
    let settings = parse(Path::new("robot.toml"), text.as_bytes(), &Machine::here()).unwrap().settings;
    let foot = settings.motors.iter().find(|motor| motor.name == "foot").unwrap();
    let vmax = |reported| end_findings(foot, [12.5, reported, 10.0])[1].clone();
    assert_eq!([vmax(50.0), vmax(50.01)].map(|finding| finding.verdict), [Verdict::Agrees; 2]);
    let wrong = vmax(30.0);
    assert_eq!(wrong.verdict, Verdict::Differs);
    assert!(wrong.cure.contains("write velocity-end-rad-s = 30.0"), "{wrong}");
    assert_eq!(end_lines(foot, [12.5, 50.0, 10.0]), None);
    let lines = "position-end-rad = 12.5\nvelocity-end-rad-s = 30.0\ntorque-end-nm = 10.0";
    assert_eq!(end_lines(foot, [12.5, 30.0, 10.0]).as_deref(), Some(lines));
    assert_eq!(end_lines(foot, [f32::NAN, 30.0, 10.0]), None);
}
