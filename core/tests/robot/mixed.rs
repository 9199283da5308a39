//! Goal: motors of several vendors work together in one robot.
//! Method: the shipped configuration of three vendors' motors, on virtual time with their simulated
//! twins.

use motord_harness::robot;
use motord_harness::robot::Robot;
use motord_harness::robot::checker::VENDORS;
use motord_protocol::fault::FAULTS;
use motord_shared::{Fault, JointSetpoint, MotorMode, Phase};

fn mixed() -> Robot {
    let text = include_str!("../../../config/mixed-simulated.toml");
    Robot::built(robot::settings(text), 3, |_, _| {})
}

fn vendor(robot: &Robot, joint: usize) -> &'static str {
    robot.settings.motors[joint].profile.name
}

#[test]
fn motors_of_three_vendors_follow_one_wave() {
    let mut robot = mixed();
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
        let has_temperature = vendor(&robot, joint) != "steadywin";
        assert_eq!(reported.temperature.is_finite(), has_temperature, "joint {joint}");
    }
}

#[test]
fn faults_of_each_vendor_use_the_same_words() {
    for judged in VENDORS {
        let mut robot = mixed();
        robot.activate();
        let joint = (0..12).find(|&joint| vendor(&robot, joint) == judged.name).expect("one of each");
        let name = robot.settings.motors[joint].name.clone();
        robot.disturb(&format!("{name} {}", judged.over_voltage));
        (0..300).for_each(|_| robot.step());
        assert_eq!(robot.joint(joint).mode, MotorMode::Fault.code(), "{}", judged.name);
        assert_eq!(robot.joint(joint).fault, motord_protocol::Faults::OVER_VOLTAGE.0, "{}", judged.name);
    }
}

/// The two crates share no code, so each has the table.
#[test]
fn clients_know_every_fault_word_and_bit() {
    let reported = FAULTS.map(|fault| (fault.bit, fault.name, fault.sentence));
    let known: Vec<_> =
        Fault::ALL.iter().map(|fault| (fault.bit(), fault.name(), fault.sentence())).collect();
    assert_eq!(known, reported);
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

/// A drive that lost its supply for a moment boots disabled, without a fault, and answers every
/// command.
#[test]
fn motor_reporting_off_while_following_stops_group() {
    let mut robot = Robot::built(
        robot::settings(include_str!("../../../config/mixed-simulated.toml")),
        3,
        |_, motors| {
            motors.iter_mut().for_each(|motor| motor.boot_time = motord_bus::Duration::from_millis(3));
        },
    );
    let joints = robot.activate();
    let joint = (0..12).find(|&joint| vendor(&robot, joint) == "damiao").expect("one of each");
    let name = robot.settings.motors[joint].name.clone();
    robot.disturb(&format!("{name} power-cycle"));
    (0..30).for_each(|_| robot.follow(&joints));
    assert_eq!(robot.cause(), Some(motord_shared::Cause::MotorOff));
}
