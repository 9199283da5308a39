//! Goal: motors of several vendors work together in one robot.
//! Method: the shipped configurations of several vendors' motors, on virtual time with their simulated
//! twins.

use super::family;
use motord_bus::Duration;
use motord_harness::robot;
use motord_harness::robot::Robot;
use motord_harness::robot::checker::VENDORS;
use motord_settings::plan::BusPlan;
use motord_settings::settings::Settings;
use motord_shared::{Cause, JointSetpoint, MotorMode, Phase};
use motord_simulator::RobStrideFirmware;

/// In MIT, and in the protocols from the factory.
const ROBOTS: [&str; 2] = [
    include_str!("../../../config/mixed-simulated.toml"),
    include_str!("../../../config/factory-simulated.toml"),
];

fn mixed() -> Robot {
    Robot::built(robot::settings(ROBOTS[0]), 3, |_, _| {})
}

/// Returns a robot that has a motor of this vendor.
fn robot_with(vendor: &str) -> Robot {
    let settings = ROBOTS.map(robot::settings);
    let has_one = |settings: &Settings| settings.motors.iter().any(|motor| motor.profile.name == vendor);
    Robot::built(settings.into_iter().find(has_one).expect("one of each vendor"), 3, |_, _| {})
}

fn vendor(robot: &Robot, joint: usize) -> &'static str {
    robot.settings.motors[joint].profile.name
}

#[test]
fn motors_of_several_vendors_follow_one_wave() {
    for text in ROBOTS {
        check_wave(&mut Robot::new(robot::settings(text), 3));
    }
}

fn check_wave(robot: &mut Robot) {
    let still = robot.activate();
    for cycle in 0..2000_u16 {
        let phase = f32::from(cycle) / 1000.0 * core::f32::consts::TAU;
        let wave = |still: &JointSetpoint| JointSetpoint {
            position: still.position + 0.1 * (1.0 - phase.cos()),
            kp: 30.0,
            ..*still
        };
        robot.send(&still.iter().map(wave).collect::<Vec<_>>());
        robot.step();
        assert_eq!(robot.phase(), Phase::Active, "stopped after {cycle} cycles: {:?}", robot.cause());
    }
    for joint in 0..robot.settings.motors.len() {
        let reported = robot.joint(joint);
        assert_eq!(reported.fault, 0);
        // SteadyWin's have one in GIM only. An ODrive sends none as docs/motors.md sets it up.
        let is_gim = robot.settings.motors[joint].protocol.name() == "gim";
        let has_temperature = is_gim || !["steadywin", "odrive"].contains(&vendor(robot, joint));
        assert_eq!(reported.temperature.is_finite(), has_temperature, "joint {joint}");
    }
}

#[test]
fn faults_of_each_vendor_use_the_same_words() {
    for tested in VENDORS {
        let mut robot = robot_with(tested.name);
        robot.activate();
        let joint = (0..12).find(|&joint| vendor(&robot, joint) == tested.name).expect("one of each");
        let name = robot.settings.motors[joint].name.clone();
        robot.disturb(&format!("{name} {}", tested.over_voltage));
        (0..300).for_each(|_| robot.step());
        assert_eq!(robot.joint(joint).mode, MotorMode::Fault.code(), "{}", tested.name);
        assert_eq!(robot.joint(joint).fault, motord_protocol::Faults::OVER_VOLTAGE.0, "{}", tested.name);
    }
}

/// Bit 20 is not documented, and as the shape of a report it is unexpected, even after a healthy
/// motor's first reports.
#[test]
fn undocumented_fault_of_healthy_motor_is_reported() {
    let mut robot = mixed();
    robot.activate();
    (0..1000).for_each(|_| robot.step());
    let joint = (0..12).find(|&joint| vendor(&robot, joint) == "robstride").expect("one of each");
    let name = robot.settings.motors[joint].name.clone();
    robot.disturb(&format!("{name} fault 0x100000"));
    (0..600).for_each(|_| robot.step());
    assert_eq!(robot.joint(joint).mode, MotorMode::Fault.code());
    assert_eq!(robot.joint(joint).fault, motord_protocol::Faults::of_unknown_code(20).0);
}

/// Returns the mixed robot with these changes to its simulated motors.
fn mixed_with(change: impl Fn(&mut motord_simulator::MotorSettings)) -> Robot {
    let text = include_str!("../../../config/mixed-simulated.toml");
    Robot::built(robot::settings(text), 3, |_, motors| motors.iter_mut().for_each(&change))
}

/// Returns the first joint with a motor of this vendor, and its name.
fn joint_of(robot: &Robot, name: &str) -> (usize, String) {
    let joint = (0..12).find(|&joint| vendor(robot, joint) == name).expect("one of each");
    (joint, robot.settings.motors[joint].name.clone())
}

/// A drive that lost its supply for a moment boots disabled, without a fault, and answers every
/// command.
#[test]
fn motor_reporting_off_while_following_stops_group() {
    for vendor in ["damiao", "robstride"] {
        let mut robot = mixed_with(|motor| motor.boot_time = Duration::from_millis(3));
        let joints = robot.activate();
        let (joint, name) = joint_of(&robot, vendor);
        robot.disturb(&format!("{name} power-cycle"));
        (0..30).for_each(|_| robot.follow(&joints));
        let stop = (robot.cause(), robot.group().cause_joint);
        assert_eq!(stop, (Some(Cause::MotorOff), joint as u32), "{vendor}");
    }
}

const FIRMWARES: [RobStrideFirmware; 2] = [RobStrideFirmware::Manual2025, RobStrideFirmware::Manual2026];

#[test]
fn heat_protects_robstride_motors_of_both_firmwares() {
    for firmware in FIRMWARES {
        let mut robot = mixed_with(|motor| motor.behaviour.firmware = firmware);
        let joints = robot.activate();
        let (joint, name) = joint_of(&robot, "robstride");
        assert!((robot.joint(joint).temperature - 25.0).abs() < 1.0, "{firmware:?}");
        robot.disturb(&format!("{name} temperature 95"));
        (0..1100).for_each(|_| robot.follow(&joints));
        let stop = (robot.cause(), robot.group().cause_joint);
        assert_eq!(stop, (Some(Cause::OverTemperature), joint as u32), "{firmware:?}");
    }
}

/// Goal: the fault bit of a state makes motord ask for the fault. Method: without regular
/// questions.
#[test]
fn unnamed_fault_is_named_within_ten_cycles() {
    let mut settings = robot::settings(include_str!("../../../config/mixed-simulated.toml"));
    settings.safety.fault_poll_hz = 0.0;
    let mut robot = Robot::new(settings, 3);
    let joints = robot.activate();
    let (joint, name) = joint_of(&robot, "robstride");
    robot.disturb(&format!("{name} fault 0x04"));
    (0..10).for_each(|_| robot.follow(&joints));
    assert_eq!(robot.joint(joint).fault, motord_protocol::Faults::UNDER_VOLTAGE.0);
    assert_eq!((robot.mode(joint), robot.group().cause_joint), (MotorMode::Fault, joint as u32));
}

/// Goal: heat protection that no longer works is a cause. Method: -60 degrees, in both forms of a
/// code.
#[test]
fn impossible_temperature_stops_group_after_a_second() {
    for vendor in ["damiao", "robstride"] {
        let mut robot = mixed_with(|_| {});
        let joints = robot.activate();
        let (joint, name) = joint_of(&robot, vendor);
        robot.disturb(&format!("{name} temperature -60"));
        (0..990).for_each(|_| robot.follow(&joints));
        assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None), "{vendor}");
        (0..50).for_each(|_| robot.follow(&joints));
        let stop = (robot.cause(), robot.group().cause_joint);
        assert_eq!(stop, (Some(Cause::TemperatureSensor), joint as u32), "{vendor}");
    }
}

#[test]
fn frost_is_a_temperature_of_each_vendor() {
    for firmware in FIRMWARES {
        let mut robot = mixed_with(|motor| {
            motor.behaviour.firmware = firmware;
            motor.ambient_celsius = -15.0;
        });
        let joints = robot.activate();
        (0..1200).for_each(|_| robot.follow(&joints));
        assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None), "{firmware:?}");
        for vendor in ["damiao", "robstride"] {
            let (joint, _) = joint_of(&robot, vendor);
            let temperature = robot.joint(joint).temperature;
            assert!((-16.0..=-10.0).contains(&temperature), "{vendor} {firmware:?}: {temperature} °C");
        }
    }
}

/// Goal: every rate that the configuration accepts works.
/// Method: the highest rate with one, three and six motors of each family on a bus, for 2 s at rest,
/// and for 10 s with motors that follow a sine. Reports that motors send by themselves may delay single
/// replies.
#[test]
fn highest_accepted_rate_misses_no_reply() {
    for (family, motors) in
        family::FAMILIES.into_iter().flat_map(|family| [1, 3, 6].map(|motors| (family, motors)))
    {
        let rate_hz = BusPlan::of(&family::motors_at(family, motors, 50))[0].rate_hz_max.floor() as u32;
        let mut robot = Robot::new(family::motors_at(family, motors, rate_hz), u64::from(motors));
        let has_reports = !robot.settings.motors[0].protocol.family().reports.is_empty();
        let check = |robot: &mut Robot, cycles: u32| {
            let missed = (0..usize::from(motors)).map(|joint| robot.joint(joint).missed).sum::<u32>();
            let most = if has_reports { u32::from(motors) * cycles / 10 } else { 0 };
            assert!(missed <= most, "{motors} {family:?} at {rate_hz} Hz: {missed} of {cycles} cycles");
        };
        robot.steps(2 * rate_hz as usize);
        check(&mut robot, 2 * rate_hz);
        let rest = robot.activate();
        for cycle in 0..10 * rate_hz {
            let angle = f64::from(cycle) / f64::from(rate_hz) * std::f64::consts::TAU;
            let moved = |joint: &JointSetpoint| JointSetpoint {
                position: joint.position + 0.3 * angle.sin() as f32,
                ..*joint
            };
            robot.follow(&rest.iter().map(moved).collect::<Vec<_>>());
        }
        assert_eq!(robot.phase(), Phase::Active, "{motors} {family:?} at {rate_hz} Hz");
        check(&mut robot, 12 * rate_hz);
    }
}
