//! Joints that an operator excludes from their group.

use motord_harness::robot;
use motord_harness::robot::{Meaning, Robot};
use motord_shared::{JointSetpoint, MotorMode, Operation, Phase, Refusal};

fn of_joint(robot: &mut Robot, operation: Operation, joint: u32) -> Result<(), Refusal> {
    robot.operate_joint(operation, joint as usize).map(|_| ())
}

/// Returns three motors, of which the second may be excluded.
fn with_excludable_thigh() -> Robot {
    let mut settings = robot::three_motors();
    settings.motors[1].may_be_excluded = true;
    Robot::new(settings, 1)
}

#[test]
fn excluded_joint_receives_stops_only() {
    let mut robot = with_excludable_thigh();
    robot.disturb("thigh off");
    robot.steps(50);
    of_joint(&mut robot, Operation::Exclude, 1).expect("the group is disarmed");
    assert_eq!(robot.mode(1), MotorMode::Excluded);
    robot.claim().expect("the group is free");
    let mut joints = robot.hold(20.0, 1.0);
    // A controller that does not use the joint sends invalid values.
    joints[1] = JointSetpoint { position: f32::NAN, ..Default::default() };
    robot.follow(&joints);
    robot.operate(Operation::Enable).expect("it may be excluded");
    robot.follow_until(&joints, 200, |robot| robot.phase() == Phase::Active);
    robot.take_sent();
    for _ in 0..500 {
        robot.follow(&joints);
    }
    let sent = robot.take_sent();
    let to = |id| sent.iter().filter(move |sent| sent.id == id);
    assert!(to(2).all(|sent| sent.meaning == Meaning::Stop) && (4..=6).contains(&to(2).count()));
    assert!(
        to(1).chain(to(3)).all(|sent| matches!(sent.meaning, Meaning::Control { .. } | Meaning::GetFault))
    );
    assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None));
}

#[test]
fn returning_excluded_joint_stays_stopped() {
    let mut robot = with_excludable_thigh();
    robot.steps(20);
    of_joint(&mut robot, Operation::Exclude, 1).expect("the group is disarmed");
    let joints = robot.activate();
    for verb in ["thigh off", "thigh ok", "thigh fault 0x40", "thigh duplicate", "thigh garbage", "thigh ok"]
    {
        robot.disturb(verb);
        for _ in 0..300 {
            robot.follow(&joints);
        }
        assert_eq!((robot.phase(), robot.mode(1)), (Phase::Active, MotorMode::Excluded), "{verb}");
    }
    robot.operate(Operation::Disable).expect("anybody may");
    robot.steps(2500);
    of_joint(&mut robot, Operation::Include, 1).expect("the group is disarmed");
    robot.disturb("thigh power-cycle");
    robot.steps(1000);
    assert_eq!(robot.mode(1), MotorMode::Idle);
}

#[test]
fn only_spared_joints_may_be_missing_on_enable() {
    let mut robot = with_excludable_thigh();
    robot.steps(20);
    of_joint(&mut robot, Operation::Exclude, 0).expect("the group is disarmed");
    robot.claim().expect("the group is free");
    let joints = robot.hold(20.0, 1.0);
    robot.follow(&joints);
    assert_eq!(robot.operate(Operation::Enable), Err(Refusal::Excluded));
    assert_eq!(of_joint(&mut robot, Operation::SetZero, 0), Err(Refusal::Excluded));
    of_joint(&mut robot, Operation::Include, 0).expect("the group is disarmed");
    assert_eq!(of_joint(&mut robot, Operation::Exclude, 9), Err(Refusal::UnknownJoint));
}

#[test]
fn joint_of_moving_group_cannot_be_excluded() {
    let mut robot = with_excludable_thigh();
    let joints = robot.activate();
    for operation in [Operation::Exclude, Operation::Include] {
        robot.send(&joints);
        assert_eq!(of_joint(&mut robot, operation, 1), Err(Refusal::NotDisarmed));
    }
}

/// A setpoint for an excluded joint is not checked, so it is not used after the joint is included
/// again.
#[test]
fn ignored_setpoint_is_not_used_after_inclusion() {
    let mut robot = with_excludable_thigh();
    robot.steps(20);
    of_joint(&mut robot, Operation::Exclude, 1).expect("the group is disarmed");
    robot.claim().expect("the group is free");
    let mut joints = robot.hold(20.0, 1.0);
    joints[1].position = f32::NAN;
    robot.follow(&joints);
    of_joint(&mut robot, Operation::Include, 1).expect("the group is disarmed");
    robot.steps(5);
    assert_eq!(robot.operate(Operation::Enable), Err(Refusal::NoSetpoint));
}
