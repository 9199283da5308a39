//! The fault catalogue, part A: motors that fail, against simulated buses on virtual time.
//! `docs/faults.md` lists the item of each test.

use crate::faults_bus::{active, stopped_within};
use motord_bus::Duration;
use motord_core::control::Event;
use motord_harness::robot;
use motord_harness::robot::{Meaning, PERIOD, Robot};
use motord_settings::settings::FaultPolicy;
use motord_shared::{
    AdminRequest, Cause, JointSetpoint, Limit, MotorMode, Operation, Phase, Refusal, message,
};
use motord_simulator::Dialect;

#[test]
fn motors_losing_alternate_replies_are_named_and_stopped() {
    let mut text = String::from("[cycle]\nrate-hz = 500\n[[bus]]\nname = \"can\"\ntype = \"simulated\"\n");
    for (id, name) in [(1, "a"), (2, "b"), (3, "c"), (4, "d")] {
        text += &robot::motor(id, name, "can", "");
    }
    let mut robot = Robot::new(robot::settings(&text), 3);
    let joints = robot.activate();
    robot.disturb("b intermittent 70%");
    robot.disturb("c intermittent 70%");
    let (cause, _) = stopped_within(&mut robot, &joints, 3000);
    assert_eq!(cause, Cause::MotorLost);
    assert!([1, 2].contains(&robot.group().cause_joint));
    let missed: Vec<_> = (0..4).map(|joint| robot.joint(joint).missed).collect();
    assert!(missed[0] == 0 && missed[3] == 0 && missed[1] > 5 && missed[2] > 5, "{missed:?}");
}

/// Goal: a motor whose every answer is several cycles old is not driven on. Method: at 300 Hz, 20
/// ms are six periods, so that each answer arrives at the usual time after a request.
#[test]
fn constantly_late_answers_stop_the_group() {
    let mut text = String::from("[cycle]\nrate-hz = 300\n[[bus]]\nname = \"can\"\ntype = \"simulated\"\n");
    for (id, name) in [(1, "a"), (2, "b")] {
        text += &robot::motor(id, name, "can", "");
    }
    let mut robot = Robot::new(robot::settings(&text), 3);
    let joints = robot.activate();
    robot.disturb("b delayed 20ms");
    let (cause, _) = stopped_within(&mut robot, &joints, 300);
    assert_eq!((cause, robot.group().cause_joint), (Cause::MotorLost, 1));
}

#[test]
fn power_failed_motor_is_stopped_and_never_restarted() {
    let (mut robot, joints) = active();
    robot.disturb("thigh power-cycle");
    let (cause, _) = stopped_within(&mut robot, &joints, 12);
    assert_eq!((cause, robot.group().cause_joint), (Cause::MotorLost, 1));
    robot.take_sent();
    robot.steps(3000);
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()));
    assert_eq!((robot.mode(1), robot.truth(1).mode()), (MotorMode::Idle, motord_simulator::Mode::Stopped));
    robot.operate(Operation::Reset).unwrap();
    let mut far = robot.hold(40.0, 1.0);
    far[1].position += 0.5;
    robot.follow(&far);
    assert_eq!(robot.operate(Operation::Enable).unwrap_err(), Refusal::NoOwner, "its owner was given up");
    robot.activate();
}

#[test]
fn motor_left_running_is_stopped_and_forgets_target() {
    use motord_bus::{Bus, Frame, FrameId};
    let mut robot = Robot::new(robot::three_motors(), 1);
    let id = FrameId::new(1).unwrap();
    let start = Frame::classic(id, [255, 255, 255, 255, 255, 255, 255, 0xFC]);
    // Position 2 rad, kp 100, kd 1.
    let pull = Frame::classic(id, [0x94, 0x7A, 0x80, 0x03, 0x33, 0x33, 0x38, 0x00]);
    let before = robot.now() - Duration::from_millis(5);
    robot.buses[0].with(|bus| bus.send(before, &[start, pull]));
    robot.steps(50);
    assert_eq!(robot.truth(0).mode(), motord_simulator::Mode::Stopped);
    assert!(
        robot
            .take_sent_to(1)
            .iter()
            .filter(|sent| sent.at > before + PERIOD)
            .all(|sent| sent.meaning.is_safe())
    );
    robot.steps(500);
    let stands = robot.truth(0).position();
    robot.activate();
    robot.steps(19);
    assert!((robot.truth(0).position() - stands).abs() < 0.02, "the old target does not move it");
}

/// Goal: a joint far from its setpoint stops the group without a key, unless it approaches. Method:
/// a blocked joint, and one that moves.
#[test]
fn blocked_joint_half_turn_away_stops_group() {
    for (friction, expected) in [(100.0, Some(Cause::FollowingError)), (0.15, None)] {
        let mut settings = robot::three_motors();
        settings.motors.iter_mut().for_each(|motor| motor.limits.position = [-7.0, 7.0]);
        let mut robot = Robot::built(settings, 1, |_, motors| motors[2].coulomb_friction = friction);
        let mut joints = robot.activate();
        joints[2] = JointSetpoint { position: 5.0, kp: 20.0, kd: 0.5, ..joints[2] };
        (0..1500).for_each(|_| robot.follow(&joints));
        assert_eq!(robot.cause(), expected, "{friction}: {}", robot.joint(2).position);
    }
}

#[test]
fn mute_drive_is_named_within_two_seconds() {
    let mut robot = Robot::built(robot::three_motors(), 1, |_, motors| motors[1].dialect = Dialect::Gim);
    robot.disturb("knee off");
    robot.steps(2100);
    let silent: Vec<_> =
        robot.take_events().into_iter().filter(|event| matches!(event, Event::Silent { .. })).collect();
    assert_eq!(silent, [Event::Silent { motor: 1 }, Event::Silent { motor: 2 }]);
    robot.claim().unwrap();
    let joints = [JointSetpoint::default(); 3];
    robot.follow(&joints);
    assert_eq!(robot.operate(Operation::Enable).unwrap_err(), Refusal::MotorOffline);
    let received = robot.take_sent_to(2);
    assert!(
        received.iter().all(|sent| !matches!(sent.meaning, Meaning::Control { .. })),
        "it may read it as another command"
    );
}

#[test]
fn motor_fault_while_starting_fails_start_immediately() {
    let mut settings = robot::three_motors();
    settings.motors.iter_mut().for_each(|motor| motor.fault_policy = FaultPolicy::StopJoint);
    let mut robot = Robot::new(settings, 1);
    robot.steps(200);
    robot.claim().unwrap();
    let joints = robot.hold(40.0, 1.0);
    robot.follow(&joints);
    robot.operate(Operation::Enable).unwrap();
    robot.disturb("knee fault 0x40");
    robot.follow_until(&joints, 150, |robot| robot.cause().is_some());
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::StartFailed), 2));
}

#[test]
fn over_voltage_is_damped_less() {
    let (mut robot, joints) = active();
    robot.disturb("hip voltage 70");
    let (cause, _) = stopped_within(&mut robot, &joints, 150);
    assert_eq!((cause, robot.joint(0).fault & 0x02), (Cause::MotorFault, 0x02));
    robot.take_sent();
    robot.step();
    let damping: Vec<_> =
        robot.take_sent().into_iter().filter(|sent| sent.id != 1).map(|sent| sent.meaning).collect();
    assert!(
        damping
            .iter()
            .all(|meaning| matches!(meaning, Meaning::Control { kd, .. } if *kd > 0.1 && *kd < 0.6)),
        "{damping:?}"
    );
}

/// Over-voltage that is over weakens no later stop, although it stopped only its joint and left
/// nothing to reset.
#[test]
fn past_over_voltage_does_not_weaken_later_damping() {
    let mut settings = robot::three_motors();
    settings.motors.iter_mut().for_each(|motor| motor.fault_policy = FaultPolicy::StopJoint);
    let mut robot = Robot::new(settings, 1);
    let joints = robot.activate();
    robot.disturb("hip voltage 70");
    robot.follow_until(&joints, 150, |robot| robot.mode(0) == MotorMode::Fault);
    robot.operate(Operation::Disable).unwrap();
    robot.steps(500);
    robot.disturb("hip voltage 48");
    robot.operate(Operation::ClearFault).unwrap();
    robot.activate();
    robot.operate(Operation::Disable).unwrap();
    robot.take_sent();
    robot.step();
    let (full, sent) = (f64::from(robot.settings.motors[0].damping_kd), robot.take_sent());
    let is_full = |kd: f64| (kd - full).abs() < 0.01 * full;
    assert!(
        sent.iter().all(|sent| matches!(sent.meaning, Meaning::Control { kd, .. } if is_full(kd))),
        "{sent:?}"
    );
}

/// Goal: a motor whose every second state is wrong is not ignored for ever.
#[test]
fn every_second_implausible_state_stops_the_group() {
    let (mut robot, joints) = active();
    for _ in 0..25 {
        robot.disturb("hip wrong");
        robot.follow(&joints);
        robot.disturb("hip ok");
        robot.follow(&joints);
    }
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::Implausible), 0));
}

/// Goal: a torque that the motor cannot give is a cause. Method: a blocked motor, configured with a
/// smaller peak.
#[test]
fn impossible_torque_stops_the_group() {
    let mut settings = robot::three_motors();
    settings.motors[0].winding.peak_torque = 1.0;
    let mut robot = Robot::built(settings, 1, |_, motors| motors[0].coulomb_friction = 100.0);
    let mut joints = robot.activate();
    joints[0] = JointSetpoint { torque: 5.0, ..Default::default() };
    let (cause, _) = stopped_within(&mut robot, &joints, 300);
    assert_eq!((cause, robot.group().cause_joint), (Cause::Implausible, 0));
}

/// Goal: no setpoint heats a winding more than the rated torque does.
/// Method: a blocked hip gets setpoints of twice its rated torque for a minute. The test computes
/// the heat of the winding from the square of the torque on the wire.
#[test]
fn twice_rated_torque_falls_to_rated_after_while() {
    let mut robot = Robot::built(robot::three_motors(), 1, |_, motors| motors[0].coulomb_friction = 100.0);
    let winding = &robot.settings.motors[0].winding;
    let (rated, overload) = (winding.rated_torque, winding.overload);
    let mut joints = robot.activate();
    joints[0] = JointSetpoint { torque: 2.0 * rated, ..Default::default() };
    let time = overload.as_secs_f64() / (4.0_f64 / 3.0).ln();
    let (mut heat, mut full, mut last) = (0.0, 0, 0.0);
    for cycle in 0..60_000 {
        robot.follow(&joints);
        for sent in robot.take_sent_to(1) {
            let Meaning::Control { torque, .. } = sent.meaning else { continue };
            full = if torque > 1.99 * f64::from(rated) { cycle } else { full };
            heat += ((torque / f64::from(rated)).powi(2) - heat) * 1e-3 / time;
            last = torque;
        }
    }
    assert!((5_000..10_000).contains(&full), "the full torque for {full} ms of {overload:?}");
    assert!(
        (last / f64::from(rated) - 1.0).abs() < 0.02 && heat < 1.01,
        "{last} N·m in the end, heat {heat}"
    );
    assert_ne!(robot.joint(0).limits & Limit::Overload.bit(), 0, "and it is reported");
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
}

#[test]
fn a_joint_that_runs_away_stops_the_group() {
    let (mut robot, joints) = active();
    robot.disturb("hip load 60");
    let (cause, _) = stopped_within(&mut robot, &joints, 300);
    assert!(matches!(cause, Cause::Overspeed | Cause::Implausible), "{cause}");
}

#[test]
fn a_joint_that_cannot_follow_stops_the_group() {
    let mut settings = robot::three_motors();
    settings.motors[2].limits.following_error = Some(0.2);
    let mut robot = Robot::new(settings, 1);
    let joints = robot.activate();
    robot.disturb("knee load 12");
    let (cause, cycles) = stopped_within(&mut robot, &joints, 500);
    assert_eq!((cause, robot.group().cause_joint), (Cause::FollowingError, 2));
    assert!(cycles >= 50);
}

#[test]
fn set_zero_of_turning_joint_is_refused() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.disturb("hip load 0.5");
    robot.steps(300);
    let request = AdminRequest { operation: Operation::SetZero.code(), joint: 0, ..Default::default() };
    assert_eq!(robot.ask(request).unwrap_err(), Refusal::Moving);
}

/// While a motor writes its zero into its flash, its silence cannot be distinguished from a
/// failure.
#[test]
fn motor_lost_during_set_zero_is_never_enabled() {
    let (mut robot, joints) = active();
    robot.operate(Operation::Disable).expect("the group may be disabled");
    robot.follow_until(&joints, 3000, |robot| robot.phase() == Phase::Disarmed);
    let zero = AdminRequest { operation: Operation::SetZero.code(), joint: 0, ..Default::default() };
    robot.post(zero);
    robot.disturb("hip off");
    robot.take_sent();
    let mut cycles = 0;
    while robot.mode(0) != MotorMode::Offline {
        robot.send(&joints);
        assert!(robot.operate(Operation::Enable).is_err(), "its group stays stopped");
        assert_eq!(robot.joint(0).flags & message::JOINT_FRESH, 0, "its last report does not count as fresh");
        cycles += 1;
    }
    assert!(cycles <= 3000 + 20, "{cycles}");
    let beyond_stop = robot.take_sent().into_iter().filter(|sent| sent.id == 1 && !sent.meaning.is_safe());
    assert_eq!(beyond_stop.count(), 1, "the request itself, and no more");
}

#[test]
fn set_zero_of_silent_motor_is_finally_refused() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(10);
    robot.disturb("hip off");
    let request = AdminRequest { operation: Operation::SetZero.code(), joint: 0, ..Default::default() };
    assert_eq!(robot.ask(request).unwrap_err(), Refusal::NotConfirmed);
}

/// A zero is stored in flash, which endures some ten thousand writes.
#[test]
fn repeated_zeros_spare_the_flash() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(10);
    let zero = |robot: &mut Robot, joint| {
        robot.ask(AdminRequest { operation: Operation::SetZero.code(), joint, ..Default::default() })
    };
    zero(&mut robot, 0).unwrap();
    zero(&mut robot, 1).unwrap();
    robot.take_sent();
    for _ in 0..20 {
        assert_eq!(zero(&mut robot, 0).unwrap_err(), Refusal::TooSoon);
        robot.steps(100);
    }
    assert!(robot.take_sent().iter().all(|sent| sent.meaning != Meaning::SetZero));
    robot.steps(8000);
    zero(&mut robot, 0).unwrap();
}

/// Returns a robot whose thigh stood at `position` when its motor restarted.
fn restarted_at(position: f64) -> Robot {
    let mut settings = robot::three_motors();
    settings.motors[1].limits.position = [-7.0, 7.0];
    settings.simulation[1].initial_position = position;
    let mut robot = Robot::new(settings, 1);
    robot.steps(50);
    robot.disturb("thigh power-cycle");
    robot.steps(1000);
    assert_eq!(robot.mode(1), MotorMode::Idle);
    robot
}

fn enable(robot: &mut Robot) -> Result<(), Refusal> {
    if robot.group().lease == 0 {
        robot.claim().expect("nobody owns it");
    }
    let joints = robot.hold(40.0, 1.0);
    robot.follow(&joints);
    robot.operate(Operation::Enable).map(drop)
}

fn clear_fault(robot: &mut Robot) {
    let request = AdminRequest { operation: Operation::ClearFault.code(), joint: 1, ..Default::default() };
    robot.ask(request).expect("it is granted");
}

#[test]
fn lost_turn_is_named_and_must_be_confirmed() {
    let mut robot = restarted_at(3.4);
    assert!((robot.joint(1).position + 2.88).abs() < 0.01, "{}", robot.joint(1).position);
    let lost = |event: &Event| matches!(event, Event::LostTurns { motor: 1, milliradians: -6300..=-6270 });
    assert_eq!(robot.take_events().iter().filter(|event| lost(event)).count(), 1);
    assert_eq!(enable(&mut robot).unwrap_err(), Refusal::TurnLost);
    clear_fault(&mut robot);
    enable(&mut robot).unwrap();
}

#[test]
fn another_absence_does_not_hide_lost_turn() {
    let mut robot = restarted_at(3.4);
    robot.disturb("thigh power-cycle");
    robot.steps(1000);
    assert_eq!(enable(&mut robot).unwrap_err(), Refusal::TurnLost);
    for operation in [Operation::Exclude, Operation::Include] {
        robot.ask(AdminRequest { operation: operation.code(), joint: 1, ..Default::default() }).unwrap();
        robot.steps(500);
    }
    assert_eq!(enable(&mut robot).unwrap_err(), Refusal::TurnLost);
}

#[test]
fn cleared_fault_confirms_no_lost_turn() {
    let mut robot = restarted_at(3.4);
    robot.disturb("thigh fault 0x40");
    robot.steps(500);
    assert_eq!(robot.mode(1), MotorMode::Fault);
    clear_fault(&mut robot);
    robot.steps(50);
    assert_eq!(enable(&mut robot).unwrap_err(), Refusal::TurnLost);
}

#[test]
fn absence_within_one_turn_needs_no_confirmation() {
    let mut robot = restarted_at(3.0);
    enable(&mut robot).unwrap();
}
