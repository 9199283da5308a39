//! ODrive Pro, S1 and Micro in the cycle, beside an MIT motor on one bus, on virtual time.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use super::family;
use motord_bus::FrameId;
use motord_core::drive::safe_frames;
use motord_harness::robot::{self, Meaning, Robot};
use motord_protocol::Faults;
use motord_shared::{Cause, JointSetpoint, MotorMode, Operation, Phase, SetpointMode};
use motord_simulator::Mode;

/// Index of the ODrive, its node, and the first of its ids.
const KNEE: usize = 1;
const NODE: u8 = 5;
const BASE: u16 = 0x0A0;

/// The bus has a turn every 10 ms, in which an ODrive from the factory sends its estimates once.
fn text() -> String {
    family::leg(family::ODRIVE)
        .replace("offset-rad = 0.2", "offset-rad = 0.2\ngear-ratio = 8\npeak-torque-nm = 10.0")
        .replace("setpoint-timeout-ms = 20", "setpoint-timeout-ms = 40")
        .replace("type = \"simulated\"", "type = \"simulated\"\nevery = 10")
}

fn leg() -> Robot {
    let mut robot = Robot::new(robot::settings(&text()), 3);
    robot.steps(500);
    robot
}

/// Setpoints that hold the hip, and this mode and value for the knee.
fn setpoints(robot: &mut Robot, mode: SetpointMode, value: f32) -> Vec<JointSetpoint> {
    let mut joints = robot.hold(40.0, 1.0);
    let knee = &mut joints[KNEE];
    let position = knee.position;
    *knee = JointSetpoint { mode: mode.code(), position, ..Default::default() };
    match mode {
        SetpointMode::Torque => knee.torque = value,
        SetpointMode::Speed => knee.velocity = value,
        SetpointMode::Position | SetpointMode::Impedance => knee.position += value,
    }
    joints
}

fn activate(robot: &mut Robot, joints: &[JointSetpoint]) {
    robot.claim().unwrap();
    robot.follow(joints);
    robot.operate(Operation::Enable).unwrap();
    (0..600).for_each(|_| robot.follow(joints));
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
}

#[test]
fn odrive_follows_torque_speed_and_position() {
    for (mode, value) in
        [(SetpointMode::Torque, 0.3), (SetpointMode::Speed, 1.0), (SetpointMode::Position, 0.05)]
    {
        let mut robot = leg();
        let at = robot.joint(KNEE).position;
        let joints = setpoints(&mut robot, mode, value);
        activate(&mut robot, &joints);
        (0..400).for_each(|_| robot.follow(&joints));
        assert_eq!(robot.phase(), Phase::Active, "{mode}: {:?}", robot.cause());
        let joint = robot.joint(KNEE);
        match mode {
            SetpointMode::Speed => assert!((joint.velocity - value).abs() < 0.2, "{}", joint.velocity),
            SetpointMode::Position => assert!((joint.position - at - value).abs() < 0.02, "{joint:?}"),
            _ => assert!(joint.position - at > 0.1 && (joint.torque - value).abs() < 0.05, "{joint:?}"),
        }
        // A state is up to a turn old.
        let error = (f64::from(joint.position) - (0.2 - robot.truth(KNEE).position())).abs();
        let most = 0.01 + 0.02 * f64::from(joint.velocity.abs());
        assert!(error < most, "{mode}: {error} rad at {} rad/s", joint.velocity);
        assert_eq!((joint.missed, joint.fault, robot.bus(0).malformed), (0, 0, 0));
    }
}

/// A change of the mode sends the new input before the mode, so that no old input acts.
#[test]
fn new_mode_follows_its_input() {
    let mut robot = leg();
    let joints = setpoints(&mut robot, SetpointMode::Torque, 0.0);
    activate(&mut robot, &joints);
    robot.take_sent();
    let position = setpoints(&mut robot, SetpointMode::Position, 0.0);
    let at = robot.joint(KNEE).position;
    (0..200).for_each(|_| robot.follow(&position));
    let sent = robot.take_sent_to(NODE.into());
    let parts: Vec<_> = sent.iter().map(|sent| sent.frame.id().raw() & 0x1F).collect();
    let first = parts.iter().position(|part| *part == 0x0C).unwrap();
    assert_eq!(parts[first..first + 4], [0x0C, 0x0C, 0x0B, 0x0C], "{parts:X?}");
    let modes = sent.iter().filter(|sent| sent.frame.id().raw() & 0x1F == 0x0B);
    assert!(modes.clone().count() >= 2 && parts.len() >= 20, "it is repeated");
    assert!((robot.joint(KNEE).position - at).abs() < 0.02, "no jump");
}

#[test]
fn odrive_is_started_at_zero_torque() {
    let mut robot = leg();
    robot.take_sent();
    let joints = setpoints(&mut robot, SetpointMode::Torque, 0.2);
    activate(&mut robot, &joints);
    let sent = robot.take_sent_to(NODE.into());
    let frames = sent.iter().map(|sent| (sent.frame.id().raw() & 0x1F, sent.bytes));
    let begin: Vec<_> = frames.skip_while(|(part, _)| *part == 0x07).take(6).collect();
    let bytes = |first: u8, fifth: u8| [first, 0, 0, 0, fifth, 0, 0, 0];
    let (torque, mode) = ((0x0E, bytes(0, 0)), (0x0B, bytes(1, 1)));
    assert_eq!(begin, [torque, mode, torque, torque, mode, (0x07, bytes(8, 0))]);
    assert_eq!(robot.truth(KNEE).mode(), Mode::Running);
}

#[test]
fn stopped_controller_brakes_then_disables_odrive() {
    let mut robot = leg();
    let joints = setpoints(&mut robot, SetpointMode::Speed, 2.0);
    activate(&mut robot, &joints);
    let before = robot.joint(KNEE).velocity;
    robot.steps(60);
    assert_eq!(robot.cause(), Some(Cause::SetpointTimeout));
    robot.steps(500);
    assert!(
        robot.joint(KNEE).velocity.abs() < 0.2 * before,
        "{before} became {}",
        robot.joint(KNEE).velocity
    );
    robot.steps(3000);
    assert_eq!((robot.phase(), robot.mode(KNEE)), (Phase::Disarmed, MotorMode::Idle));
    assert_eq!(robot.truth(KNEE).mode(), Mode::Stopped);
    assert_eq!(robot.cycle.unstopped().count(), 0, "its heartbeat confirms the stop");
}

/// No command is answered, so silence is the only sign.
#[test]
fn silent_odrive_is_lost() {
    let mut robot = leg();
    robot.disturb("knee power-off");
    robot.steps(1000);
    assert_eq!(robot.mode(KNEE), MotorMode::Offline);
    robot.disturb("knee ok");
    robot.steps(2000);
    assert_eq!(robot.mode(KNEE), MotorMode::Idle);
    let joints = setpoints(&mut robot, SetpointMode::Speed, 0.5);
    activate(&mut robot, &joints);
    robot.disturb("knee power-off");
    robot.follow_until(&joints, 200, |robot| robot.cause().is_some());
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::MotorLost), KNEE as u32));
}

#[test]
fn error_stops_group_and_is_cleared() {
    let mut robot = leg();
    let joints = setpoints(&mut robot, SetpointMode::Speed, 0.5);
    activate(&mut robot, &joints);
    robot.disturb("knee fault 0x04");
    robot.follow_until(&joints, 300, |robot| robot.cause().is_some());
    let cause = robot.cause();
    assert!(matches!(cause, Some(Cause::MotorFault | Cause::MotorOff)), "{cause:?}");
    robot.steps(3000);
    assert_eq!((robot.joint(KNEE).fault, robot.mode(KNEE)), (Faults::UNDER_VOLTAGE.0, MotorMode::Fault));
    robot.operate_joint(Operation::ClearFault, KNEE).unwrap();
    robot.steps(300);
    assert_eq!((robot.joint(KNEE).fault, robot.mode(KNEE)), (0, MotorMode::Idle));
    robot.operate(Operation::Reset).unwrap();
}

#[test]
fn zero_is_set_and_supply_reported() {
    let mut robot = leg();
    robot.operate_joint(Operation::SetZero, KNEE).unwrap();
    robot.steps(50);
    assert!((robot.joint(KNEE).position - 0.2).abs() < 0.01, "{}", robot.joint(KNEE).position);
    assert!(robot.joint(KNEE).supply_voltage > 20.0 && robot.joint(KNEE).supply_current.is_finite());
}

/// No command damps a drive whose mode is not known.
#[test]
fn safe_frames_disable_odrive() {
    let settings = robot::settings(&text());
    let (damp, stop) = safe_frames(&settings.motors[KNEE]).unwrap();
    let idle = [1, 0, 0, 0, 0, 0, 0, 0];
    for frame in [damp[0], damp[1], stop] {
        assert_eq!((frame.id(), frame.payload()), (FrameId::new(BASE | 0x07).unwrap(), &idle[..]));
    }
}

#[test]
fn stopped_odrive_gets_only_stops() {
    let mut robot = leg();
    robot.take_sent();
    robot.steps(2000);
    let sent = robot.take_sent_to(NODE.into());
    assert!(sent.len() >= 190 && sent.iter().all(|sent| sent.meaning == Meaning::Stop), "{sent:?}");
}

/// The only motor of its bus: the bus is held, and served again by what the drive sends.
#[test]
fn lonely_odrive_returns_from_power_cut() {
    let text = "[cycle]\nrate-hz = 1000\n[[bus]]\nname = \"can\"\ntype = \"simulated\"\nevery = 10\n"
        .to_owned()
        + &family::motor(family::ODRIVE, 5, "knee", "gear-ratio = 8\npeak-torque-nm = 10.0");
    let mut robot = Robot::new(robot::settings(&text), 3);
    robot.steps(500);
    assert_eq!(robot.mode(0), MotorMode::Idle);
    robot.disturb("can power-off");
    robot.steps(2000);
    assert_eq!(robot.mode(0), MotorMode::Offline);
    robot.disturb("can ok");
    robot.steps(3000);
    assert_eq!(robot.mode(0), MotorMode::Idle);
    robot.claim().unwrap();
    let joints = robot.hold(5.0, 0.5);
    (0..20).for_each(|_| robot.follow(&joints));
    robot.operate(Operation::Enable).unwrap();
    (0..600).for_each(|_| robot.follow(&joints));
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
}

/// Errors that it sends by itself, and reports that are no numbers.
#[test]
fn unreadable_reports_are_no_second_motor() {
    let mut robot = leg();
    let joints = setpoints(&mut robot, SetpointMode::Speed, 0.5);
    activate(&mut robot, &joints);
    let nan = [[0, 0, 0xC0, 0x7F]; 2].concat();
    for _ in 0..300 {
        robot.follow(&joints);
        for part in [0x03, 0x17, 0x1C] {
            robot.deliver_with_id(0, FrameId::new(BASE | part).unwrap(), &nan);
        }
    }
    assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None));
}
