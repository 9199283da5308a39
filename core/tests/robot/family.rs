//! Properties that every family of motors has.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_bus::FrameId;
use motord_harness::robot::{self, Robot, Sent};
use motord_settings::settings::Settings;
use motord_shared::{Cause, JointSetpoint, MotorMode, Operation, Phase};
use motord_simulator::Mode;

/// A protocol, a model that speaks it, and a torque limit, N·m.
pub(crate) type Family = [&'static str; 3];

pub(crate) const MIT: Family = ["mit", "GIM8108-8", "20.0"];
pub(crate) const GIM: Family = ["gim", "GIM8108-8", "20.0"];
pub(crate) const CANSIMPLE: Family = ["cansimple", "GIM6010-8", "5.0"];
pub(crate) const ROBSTRIDE: Family = ["robstride", "RS02", "12.0"];
pub(crate) const MYACTUATOR: Family = ["myactuator", "X8-20", "10.0"];
pub(crate) const ODRIVE: Family = ["odrive", "ODrive-S1", "1.0"];

/// Those whose commands are answered.
pub(crate) const FAMILIES: [Family; 5] = [MIT, GIM, CANSIMPLE, ROBSTRIDE, MYACTUATOR];

/// A motor on the bus `can`, with further keys in `more`.
pub(crate) fn motor([protocol, model, torque]: Family, id: u8, name: &str, more: &str) -> String {
    let torque_end = if protocol == "myactuator" { "torque-end-nm = 24.0\n" } else { "" };
    robot::motor(id, name, "can", &format!("{torque_end}{more}"))
        .replace("\"mit\"", &format!("\"{protocol}\""))
        .replace("GIM8108-8", model)
        .replace("torque-nm = 20.0", &format!("torque-nm = {torque}"))
        .replace("velocity-rad-s = 20.0", "velocity-rad-s = 15.0")
}

/// A SteadyWin motor in MIT, and a knee with id 5 of this family, on one bus.
pub(crate) fn leg(family: Family) -> String {
    let knee = motor(family, 5, "knee", "direction = -1\noffset-rad = 0.2");
    String::from(
        "[cycle]\nrate-hz = 1000\n[safety]\nsetpoint-timeout-ms = 20\n\
         [[bus]]\nname = \"can\"\ntype = \"simulated\"\n",
    ) + &robot::motor(1, "hip", "can", "")
        + &knee
}

/// Motors of a family on one bus at `rate_hz`, which the configuration accepts.
pub(crate) fn motors_at(family: Family, motors: u8, rate_hz: u32) -> Settings {
    let mut text = format!("[cycle]\nrate-hz = {rate_hz}\n[[bus]]\nname = \"can\"\ntype = \"simulated\"\n");
    for id in 1..=motors {
        text += &motor(family, id, &format!("joint{id}"), "");
    }
    robot::settings(&text)
}

/// The joints follow a wave of 0.4 rad for two seconds, this one with at most `error_max`, rad.
pub(crate) fn check_wave(robot: &mut Robot, joint: usize, error_max: f32) {
    let still = robot.activate();
    for cycle in 0..2000_u16 {
        let phase = f32::from(cycle) / 1000.0 * core::f32::consts::TAU;
        let wave = |still: &JointSetpoint| JointSetpoint {
            position: still.position + 0.2 * (1.0 - phase.cos()),
            kp: 60.0,
            ..*still
        };
        let wanted: Vec<_> = still.iter().map(wave).collect();
        robot.send(&wanted);
        robot.step();
        assert_eq!(robot.phase(), Phase::Active, "stopped after {cycle} cycles: {:?}", robot.cause());
        let error = (robot.joint(joint).position - wanted[joint].position).abs();
        assert!(error < error_max, "{error} rad after {cycle} cycles");
    }
}

/// Enables the joints at rest, and follows them for 200 cycles.
pub(crate) fn enable(robot: &mut Robot) {
    robot.claim().unwrap();
    let joints = robot.hold(40.0, 1.0);
    robot.follow(&joints);
    robot.operate(Operation::Enable).unwrap();
    (0..200).for_each(|_| robot.follow(&joints));
}

/// A motor with this id whose setpoints end is damped, then disabled. Returns what it was sent since.
pub(crate) fn check_stop(robot: &mut Robot, joint: usize, id: u16) -> Vec<Sent> {
    let joints = robot.activate();
    robot.follow(&joints);
    robot.take_sent();
    robot.steps(25);
    assert_eq!(robot.cause(), Some(Cause::SetpointTimeout));
    robot.step();
    let sent = robot.take_sent_to(id);
    assert!(sent.last().unwrap().meaning.is_damping(), "{sent:?}");
    robot.steps(3000);
    assert_eq!((robot.phase(), robot.mode(joint)), (Phase::Disarmed, MotorMode::Idle));
    assert_eq!(robot.truth(joint).mode(), Mode::Stopped);
    robot.take_sent_to(id)
}

/// A motor of a stopped group reports `fault`, is cleared by an operator, and runs again.
pub(crate) fn check_clearing(robot: &mut Robot, joint: usize, fault: u32) {
    robot.steps(3000);
    assert_eq!((robot.joint(joint).fault, robot.mode(joint)), (fault, MotorMode::Fault));
    robot.operate_joint(Operation::ClearFault, joint).unwrap();
    robot.steps(10);
    assert_eq!((robot.joint(joint).fault, robot.mode(joint)), (0, MotorMode::Idle));
    robot.operate(Operation::Reset).unwrap();
    robot.activate();
}

/// A motor that loses its power alone stops its group, and runs again after its power returned.
pub(crate) fn check_power_cycle(robot: &mut Robot, joint: usize) {
    let name = robot.settings.motors[joint].name.clone();
    let joints = robot.activate();
    robot.disturb(&format!("{name} power-off"));
    robot.follow_until(&joints, 30, |robot| robot.cause().is_some());
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::MotorLost), joint as u32));
    assert_eq!(robot.mode(joint), MotorMode::Offline);
    robot.steps(3000);
    robot.disturb(&format!("{name} ok"));
    robot.steps(1500);
    assert_eq!(robot.mode(joint), MotorMode::Idle);
    robot.operate(Operation::Reset).unwrap();
    robot.activate();
}

/// A joint without stiffness that turns on beyond the end of the codes, which the motor wraps, reports
/// each position.
pub(crate) fn check_unwrapping(text: &str, joint: usize) {
    let text = text
        .replace("offset-rad = 0.2", "offset-rad = 0.2\nbeyond-range = \"wrap\"")
        .replace("[-3.0, 3.0]", "[-20.0, 20.0]");
    let text = text.replacen("[-20.0, 20.0]", "[-3.0, 3.0]", 1);
    let mut robot = Robot::new(robot::settings(&text), 3);
    let mut joints = robot.activate();
    (joints[joint].kp, joints[joint].kd, joints[joint].velocity) = (0.0, 2.0, 5.0);
    robot.follow_until(&joints, 6000, |robot| robot.joint(joint).position > 14.0);
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
    let (reported, truth) = (f64::from(robot.joint(joint).position), 0.2 - robot.truth(joint).position());
    assert!((reported - truth).abs() < 0.05, "{reported} {truth}");
}

/// Active joints are not disturbed by the frames that `deliver` sends before each cycle.
pub(crate) fn check_unprompted(robot: &mut Robot, joint: usize, what: &str, deliver: impl Fn(&mut Robot)) {
    let joints = robot.activate();
    for _ in 0..1000 {
        deliver(robot);
        robot.follow(&joints);
    }
    assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None), "{what}");
    let (joint, bus) = (robot.joint(joint), robot.bus(0));
    assert_eq!((joint.fault, joint.late, joint.missed), (0, 0, 0), "{what}");
    assert_eq!((bus.malformed, bus.duplicate, bus.unexpected_id), (0, 0, 0), "{what}");
}

/// Hostile frames neither stopped the robot nor moved the joint, nor raised a fault.
pub(crate) fn check_unmoved(robot: &mut Robot, joint: usize, joints: &[JointSetpoint]) {
    assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None));
    assert_eq!(robot.joint(joint).fault, 0);
    assert!((robot.joint(joint).position - joints[joint].position).abs() < 0.05);
}

/// Joints at rest without power stay there after it returned.
pub(crate) fn check_rest<const N: usize>(robot: &mut Robot) {
    let before: [f64; N] = core::array::from_fn(|joint| robot.truth(joint).position());
    robot.disturb("can ok");
    robot.steps(2000);
    for (joint, before) in before.into_iter().enumerate() {
        let moved = robot.truth(joint).position() - before;
        assert!(moved.abs() < 1e-3, "joint {joint} moved by {moved} rad");
    }
}

/// A second motor with the ids of this one, which sends such frames, stops the group.
pub(crate) fn check_duplicate(robot: &mut Robot, joint: usize, id: FrameId, state: &[u8]) {
    let joints = robot.activate();
    for _ in 0..200 {
        robot.follow(&joints);
        robot.deliver_with_id(0, id, state);
    }
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::DuplicateId), joint as u32));
}
