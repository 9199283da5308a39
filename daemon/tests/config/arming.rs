//! A motor that differs from the configured one is never enabled, and the log contains the reason.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord::{arming, buses};
use motord_bus::Bus;
use motord_configuration::lock::Lock;
use motord_configuration::{Machine, parse};
use motord_protocol::commissioning::{ReportedMotor, ReportedProtocol};
use motord_settings::settings::Settings;
use motord_simulator::{self as simulator, Dialect, SimulatedBus};
use std::path::Path;

fn settings() -> Settings {
    let motors = [("elbow", "gim", "GIM8108-36"), ("wrist", "gim", "GIM8108-9"), ("hip", "mit", "GIM8108-8")];
    let motor = |(id, (name, protocol, model)): (u8, _)| {
        format!(
            "[[motor]]\nname = '{name}'\nbus = 'arm'\nid = {id}\nprotocol = '{protocol}'\nmodel = '{model}'\n"
        )
    };
    let motors: String = (1..).zip(motors).map(motor).collect();
    let robot = format!("[[bus]]\nname = 'arm'\ntype = 'socketcan'\ninterface = 'can0'\n{motors}");
    parse(Path::new("robot.toml"), robot.as_bytes(), &Machine::here()).unwrap().settings
}

/// Returns the motors that are marked after `change` to the motors on the bus.
fn marked(change: impl FnOnce(&mut Vec<simulator::MotorSettings>)) -> Vec<String> {
    let directory = tempfile::tempdir().unwrap();
    checked(&directory.path().join("robot.toml"), change)
}

fn checked(file: &Path, change: impl FnOnce(&mut Vec<simulator::MotorSettings>)) -> Vec<String> {
    let settings = settings();
    let (bus, mut motors) = buses::physics(&settings, 0);
    change(&mut motors);
    let bus: Box<dyn Bus> = Box::new(SimulatedBus::new(bus, motors, 1));
    let (buses, mismatched) = arming::check(&settings, file, vec![bus]).unwrap();
    assert_eq!(buses.len(), 1, "the cycle gets its bus back");
    mismatched.into_iter().map(|joint| settings.motors[joint].name.clone()).collect()
}

#[test]
fn configured_motors_are_enabled_even_if_silent() {
    assert!(marked(|_| {}).is_empty());
    assert!(marked(Vec::clear).is_empty());
}

#[test]
fn a_wrong_torque_constant_is_marked() {
    assert_eq!(marked(|motors| motors[0].torque_constant *= 1.2), ["elbow"]);
}

#[test]
fn a_wrong_gear_ratio_is_marked() {
    assert_eq!(marked(|motors| motors[1].gear_ratio = 36.0), ["wrist"]);
}

#[test]
fn swapped_ids_of_different_motors_are_marked() {
    let swap = |motors: &mut Vec<simulator::MotorSettings>| {
        (motors[0].id, motors[1].id) = (motors[1].id, motors[0].id);
        (motors[0].host_id, motors[1].host_id) = (motors[1].host_id, motors[0].host_id);
    };
    assert_eq!(marked(swap), ["elbow", "wrist"]);
}

#[test]
fn a_motor_in_the_wrong_mode_is_marked() {
    assert_eq!(marked(|motors| motors[0].dialect = Dialect::Mit), ["elbow"]);
    assert_eq!(marked(|motors| motors[2].dialect = Dialect::Gim), ["hip"]);
}

#[test]
fn a_motor_of_another_vendor_is_marked() {
    let other = |motors: &mut Vec<simulator::MotorSettings>| {
        (motors[2].vendor, motors[2].ends) = ("robstride", Some([12.57, 33.0, 14.0]));
    };
    assert_eq!(marked(other), ["hip"]);
}

#[test]
fn silent_motor_is_checked_by_the_lock() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("robot.toml");
    let elbow = ReportedMotor {
        name: "elbow".into(),
        bus: "arm".into(),
        id: 1,
        host_id: Some(0x101),
        protocol: ReportedProtocol::Gim,
        firmware: None,
        values: [("gear-ratio".to_owned(), 8.0)].into(),
    };
    Lock::new(vec![elbow]).save(&file).unwrap();
    assert_eq!(checked(&file, Vec::clear), ["elbow"]);
}
