//! The cycle with motors in native mode, on virtual time.

mod robot;

use motord_bus::{Duration, Instant};
use motord_core::control::{Command, Reported};
use motord_core::drive::{Drive, Received};
use motord_shared::{Cause, JointSetpoint, MotorMode, Operation, Phase, SetpointMode};
use robot::Robot;

fn arm() -> Robot {
    let mut text =
        String::from("[safety]\nsetpoint-timeout-ms = 20\n[[bus]]\nname = \"can\"\ntype = \"simulated\"\n");
    for (id, name) in [(1, "shoulder"), (2, "elbow")] {
        text += &robot::motor(id, name, "can", "").replace("\"mit\"", "\"gim\"");
    }
    Robot::new(robot::settings(&text), 1)
}

/// Setpoints of one mode, with `value` in its field, for both joints.
fn setpoints(mode: SetpointMode, value: f32) -> Vec<JointSetpoint> {
    let mut joint = JointSetpoint { mode: mode.code(), ..Default::default() };
    match mode {
        SetpointMode::Torque => joint.torque = value,
        SetpointMode::Speed => joint.velocity = value,
        SetpointMode::Position | SetpointMode::Impedance => joint.position = value,
    }
    vec![joint; 2]
}

fn activate(robot: &mut Robot, joints: &[JointSetpoint]) {
    robot.steps(300);
    assert_eq!([robot.mode(0), robot.mode(1)], [MotorMode::Idle; 2], "they tell their angle while stopped");
    robot.claim().expect("the group is free");
    robot.follow(joints);
    robot.operate(Operation::Enable).expect("all is well");
    for _ in 0..60 {
        robot.follow(joints);
    }
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
}

#[test]
fn gim_motors_start_and_follow_torque_speed_and_position() {
    for (mode, value) in
        [(SetpointMode::Torque, 0.5), (SetpointMode::Speed, 2.0), (SetpointMode::Position, 0.05)]
    {
        let mut robot = arm();
        let joints = setpoints(mode, value);
        activate(&mut robot, &joints);
        for _ in 0..500 {
            robot.follow(&joints);
        }
        assert_eq!(robot.phase(), Phase::Active, "{mode}: {:?}", robot.cause());
        let joint = robot.joint(0);
        match mode {
            SetpointMode::Speed => assert!((joint.velocity - value).abs() < 0.5, "{}", joint.velocity),
            SetpointMode::Position => assert!((joint.position - value).abs() < 0.02, "{}", joint.position),
            _ => assert!(joint.position > 0.1, "{}", joint.position),
        }
        assert!(joint.temperature.is_finite(), "native replies tell a temperature");
    }
}

#[test]
fn gim_motors_are_damped_when_their_owner_dies() {
    let mut robot = arm();
    let joints = setpoints(SetpointMode::Speed, 3.0);
    activate(&mut robot, &joints);
    for _ in 0..600 {
        robot.follow(&joints);
    }
    let before = robot.joint(0).velocity;
    robot.steps(25);
    assert_eq!(robot.cause(), Some(Cause::SetpointTimeout));
    robot.steps(200);
    assert!(robot.joint(0).velocity.abs() < 0.2 * before, "{before} became {}", robot.joint(0).velocity);
    robot.steps(2500);
    assert_eq!(robot.phase(), Phase::Disarmed);
    robot.steps(3);
    assert_eq!(robot.cycle.unstopped().count(), 0, "they answered their stops");
}

#[test]
fn a_request_that_the_motor_cannot_read_is_refused_once_and_waits_no_longer() {
    let robot = arm();
    let mut drive = Drive::new(&robot.settings.motors[0], Duration::ZERO, false);
    drive.request(&Command::Start, Instant::ZERO);
    assert_eq!(drive.refuse(), Received::Reply(Reported::Refused));
    assert!(!drive.is_open());
    assert_eq!(drive.refuse(), Received::Malformed, "nothing was asked");
}

#[test]
fn a_temperature_that_no_winding_can_have_so_soon_is_not_believed_once() {
    let mut robot = arm();
    let joints = setpoints(SetpointMode::Torque, 0.0);
    activate(&mut robot, &joints);
    for _ in 0..20 {
        robot.disturb("shoulder temperature 95");
        robot.follow(&joints);
        assert!(robot.joint(0).temperature < 40.0, "{} °C", robot.joint(0).temperature);
        robot.disturb("shoulder temperature 25");
        robot.follow(&joints);
    }
    assert_eq!(robot.phase(), Phase::Active);
}

#[test]
fn a_motor_that_stays_too_hot_for_a_second_stops_its_group() {
    let mut robot = arm();
    let joints = setpoints(SetpointMode::Torque, 0.0);
    activate(&mut robot, &joints);
    robot.disturb("elbow temperature 95");
    for _ in 0..990 {
        robot.follow(&joints);
    }
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
    for _ in 0..50 {
        robot.follow(&joints);
    }
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::OverTemperature), 1));
}

/// A drive that is told a speed gives what torque it takes, and nothing can be derated.
#[test]
fn a_drive_that_has_the_torque_to_itself_is_stopped_before_its_winding_is_too_warm() {
    let mut text = String::from("[[bus]]\nname = \"can\"\ntype = \"simulated\"\n");
    for (id, name) in [(1, "shoulder"), (2, "elbow")] {
        text += &robot::motor(id, name, "can", "overload-seconds = 1.0").replace("\"mit\"", "\"gim\"");
    }
    let mut robot = Robot::built(robot::settings(&text), 1, |_, motors| {
        motors[0].coulomb_friction = 15.0;
    });
    let joints = setpoints(SetpointMode::Speed, 2.0);
    activate(&mut robot, &joints);
    robot.follow_until(&joints, 3000, |robot| robot.phase() != Phase::Active);
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::OverTemperature), 0));
    assert!(robot.joint(0).temperature < robot.settings.motors[0].limits.temperature, "the model was first");
}
