//! The supply that motors report, on virtual time.

use super::family;
use motord_core::control::Event;
use motord_harness::robot::{self, Robot};
use motord_protocol::SupplyReport;
use motord_shared::{Cause, JointSetpoint, Operation, Phase, Refusal};

/// Legs of motors that report their supply, and one of motors that do not.
const FACTORY: &str = include_str!("../../../config/factory-simulated.toml");
/// Motors in native mode.
const NATIVE: &str = include_str!("../../../config/arm-native.toml");

fn reporting(robot: &Robot) -> Vec<usize> {
    let motors = robot.settings.motors.iter().enumerate();
    let reports = motors.filter(|(_, motor)| motor.capabilities.supply != SupplyReport::None);
    reports.map(|(joint, _)| joint).collect()
}

fn supply(robot: &mut Robot, joints: &[usize], volts: f64) {
    for &joint in joints {
        let name = robot.settings.motors[joint].name.clone();
        robot.disturb(&format!("{name} voltage {volts}"));
    }
}

fn voltages(robot: &mut Robot, joints: &[usize]) -> Vec<f32> {
    joints.iter().map(|&joint| (robot.joint(joint).supply_voltage * 10.0).round() / 10.0).collect()
}

/// Three CANSimple motors that are stopped below 22 V.
fn leg() -> Robot {
    let motor = |id, name| family::motor(family::CANSIMPLE, id, name, "");
    let text = String::from(
        "[cycle]\nrate-hz = 800\n[safety]\nsupply-warn-v = 23\nsupply-stop-v = 22\n\
         [[bus]]\nname = \"can\"\ntype = \"simulated\"\n",
    ) + &motor(1, "hip")
        + &motor(2, "thigh")
        + &motor(3, "knee");
    let mut robot = Robot::new(robot::settings(&text), 3);
    robot.steps(2000);
    robot
}

/// Follows setpoints for this many cycles, or until a stop.
fn follow(robot: &mut Robot, joints: &[JointSetpoint], cycles: usize) {
    for _ in 0..cycles {
        if robot.cause().is_none() {
            robot.follow(joints);
        }
    }
}

#[test]
fn motors_report_supply_at_rest_and_in_motion() {
    for text in [FACTORY, NATIVE] {
        let mut robot = Robot::new(robot::settings(text), 3);
        robot.steps(3000);
        let joints = reporting(&robot);
        assert!(joints.len() >= 3, "{joints:?}");
        supply(&mut robot, &joints, 30.5);
        robot.steps(1500);
        assert_eq!(voltages(&mut robot, &joints), vec![30.5; joints.len()], "at rest");
        let others = (0..robot.settings.motors.len()).filter(|joint| !joints.contains(joint));
        assert!(others.clone().all(|joint| robot.joint(joint).supply_voltage.is_nan()));

        let setpoints = robot.activate();
        supply(&mut robot, &joints, 31.5);
        follow(&mut robot, &setpoints, 1500);
        assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
        assert_eq!(voltages(&mut robot, &joints), vec![31.5; joints.len()], "in motion");
        for joint in 0..robot.settings.motors.len() {
            let name = robot.settings.motors[joint].name.clone();
            let joint = robot.joint(joint);
            assert_eq!((joint.fault, joint.missed, joint.implausible), (0, 0, 0), "{name}");
        }
    }
}

#[test]
fn silent_motor_has_no_supply() {
    let mut robot = leg();
    assert!(robot.joint(1).supply_voltage > 20.0 && robot.joint(1).supply_current.is_finite());
    robot.disturb("thigh power-off");
    robot.steps(500);
    assert!(robot.joint(1).supply_voltage.is_nan() && robot.joint(1).supply_current.is_nan());
}

#[test]
fn low_supply_warns_then_stops_and_forbids_motion() {
    let mut robot = leg();
    let setpoints = robot.activate();
    supply(&mut robot, &[0, 1, 2], 22.5);
    follow(&mut robot, &setpoints, 4000);
    assert_eq!(robot.phase(), Phase::Active, "a warning stops nothing");
    let warnings = |robot: &mut Robot| {
        let events = robot.take_events().into_iter();
        events.filter(|event| matches!(event, Event::Supply { .. })).collect::<Vec<_>>()
    };
    let seen = warnings(&mut robot);
    assert!(matches!(seen[..], [Event::Supply { group: 0, is_low: true, .. }]), "{seen:?}");

    supply(&mut robot, &[0, 1, 2], 21.5);
    follow(&mut robot, &setpoints, 1500);
    assert_eq!(robot.phase(), Phase::Active, "a dip of less than 2 s");
    follow(&mut robot, &setpoints, 2400);
    assert_eq!(robot.cause(), Some(Cause::SupplyLow));
    robot.steps(3000);
    assert_eq!(robot.phase(), Phase::Disarmed);
    robot.operate(Operation::Reset).unwrap();
    robot.claim().unwrap();
    (0..50).for_each(|_| robot.follow(&setpoints));
    assert_eq!(robot.operate(Operation::Enable), Err(Refusal::SupplyLow));

    supply(&mut robot, &[0, 1, 2], 24.0);
    (0..4000).for_each(|_| robot.follow(&setpoints));
    robot.operate(Operation::Enable).unwrap();
    let seen = warnings(&mut robot);
    assert!(matches!(seen[..], [Event::Supply { is_low: false, .. }]), "{seen:?}");
}

/// A sensor that is wrong, or the wires of one motor.
#[test]
fn one_motor_alone_stops_nothing() {
    let mut robot = leg();
    let setpoints = robot.activate();
    supply(&mut robot, &[1], 13.0);
    follow(&mut robot, &setpoints, 6000);
    assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None));
    assert_eq!(voltages(&mut robot, &[1]), [13.0]);
}
