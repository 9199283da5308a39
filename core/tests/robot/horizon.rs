//! Setpoints with a horizon: the cycle moves to them, and the timeout begins where they are
//! reached.

use motord_bus::Duration;
use motord_harness::robot;
use motord_harness::robot::random::Random;
use motord_harness::robot::{PERIOD, Robot};
use motord_settings::settings::{SafeStop, Settings};
use motord_shared::{AdminRequest, Cause, JointSetpoint, Lease, Operation, Phase, Rejection};

/// The largest error of a transmitted position, rad.
const CODE: f32 = 0.001;

/// An active robot whose limits do not act on slow motion.
fn active() -> (Robot, Vec<JointSetpoint>) {
    active_with(robot::three_motors())
}

fn active_with(settings: Settings) -> (Robot, Vec<JointSetpoint>) {
    let mut robot = Robot::new(settings, 1);
    let joints = robot.activate();
    (robot, joints)
}

/// Sends `joints` with a horizon.
fn send(robot: &mut Robot, joints: &[JointSetpoint], horizon: Duration) {
    let message = robot.message(joints);
    let horizon_ns = horizon.as_nanos() as u32;
    robot.deliver(&motord_shared::SetpointMessage { horizon_ns, ..message });
}

/// The same setpoints, `by` rad farther.
fn moved(joints: &[JointSetpoint], by: f32) -> Vec<JointSetpoint> {
    joints.iter().map(|joint| JointSetpoint { position: joint.position + by, ..*joint }).collect()
}

const fn ms(time: u64) -> Duration {
    Duration::from_millis(time)
}

/// The applied position of the first joint in each of `cycles` cycles.
fn positions(robot: &mut Robot, cycles: usize) -> Vec<f32> {
    let step = |robot: &mut Robot| {
        robot.step();
        robot.joint(0).applied.position
    };
    (0..cycles).map(|_| step(robot)).collect()
}

#[test]
fn position_velocity_and_torque_move_linearly() {
    let (mut robot, joints) = active();
    let mut target = moved(&joints, 0.1);
    for joint in &mut target {
        (joint.velocity, joint.torque, joint.kp) = (2.0, 1.0, 41.0);
    }
    let begin = robot.joint(0).applied;
    send(&mut robot, &target, ms(20));
    for cycle in 1..=19_u8 {
        robot.step();
        let (applied, share) = (robot.joint(0).applied, f32::from(cycle) / 20.0);
        assert!((applied.position - begin.position - 0.1 * share).abs() < 0.006, "{cycle}: {applied:?}");
        assert!((applied.velocity - 2.0 * share).abs() < 0.12, "{cycle}: {applied:?}");
        assert!((applied.torque - share).abs() < 0.06, "{cycle}: {applied:?}");
        assert!((applied.kp - 41.0).abs() < 1e-3, "{cycle}: gains come at once");
    }
    robot.steps(2);
    let applied = robot.joint(0).applied;
    assert_eq!((applied.position, applied.velocity, applied.torque), (target[0].position, 2.0, 1.0));
    assert_eq!(robot.group().setpoint_horizon_ns, 20_000_000);
}

#[test]
fn slow_owner_with_horizon_moves_evenly() {
    let (mut robot, joints) = active();
    let mut applied = Vec::new();
    for step in 1..=20_u8 {
        send(&mut robot, &moved(&joints, 0.01 * f32::from(step)), ms(25));
        applied.extend(positions(&mut robot, 20));
    }
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
    let steps: Vec<_> = applied[200..].windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(steps.iter().all(|step| (0.0003..0.0007).contains(step)), "0.5 mrad each: {steps:?}");

    // Without a horizon, the same setpoints are steps of 10 mrad.
    let before = robot.joint(0).applied.position;
    robot.send(&moved(&joints, 0.21));
    assert!(positions(&mut robot, 10)[9] - before > 0.009);
}

#[test]
fn timeout_begins_at_end_of_horizon() {
    for horizon in [0, 10, 40] {
        let (mut robot, joints) = active();
        send(&mut robot, &joints, ms(horizon));
        robot.steps(horizon as usize + 20);
        assert_eq!(robot.phase(), Phase::Active, "{horizon}: {:?}", robot.cause());
        robot.steps(2);
        assert_eq!(robot.cause(), Some(Cause::SetpointTimeout), "{horizon}");
        assert_eq!(u64::from(robot.group().setpoint_horizon_ns), horizon * 1_000_000, "kept for the advice");
        robot.take_sent();
        robot.step();
        assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()), "{horizon}: damped");
    }
}

#[test]
fn too_long_horizon_is_rejected_and_changes_nothing() {
    let (mut robot, joints) = active();
    let before = robot.group();
    send(&mut robot, &moved(&joints, 0.1), ms(40) + Duration::from_nanos(1));
    robot.step();
    let group = robot.group();
    assert_eq!(group.rejected[Rejection::Horizon as usize], before.rejected[Rejection::Horizon as usize] + 1);
    assert_eq!((group.sequence, group.setpoint_horizon_ns), (before.sequence, 0));
    assert_eq!(robot.joint(0).applied.position, joints[0].position);

    let mut settings = robot::three_motors();
    settings.safety.setpoint_horizon_max = Duration::ZERO;
    let (mut robot, joints) = active_with(settings);
    send(&mut robot, &joints, Duration::from_nanos(1));
    robot.step();
    assert_eq!(robot.group().rejected[Rejection::Horizon as usize], 1, "0 permits none");
}

#[test]
fn newer_message_continues_from_applied_position() {
    let (mut robot, joints) = active();
    send(&mut robot, &moved(&joints, 0.2), ms(40));
    let out = positions(&mut robot, 20);
    send(&mut robot, &joints, ms(40));
    let back = positions(&mut robot, 60);
    assert!((back[0] - out[19]).abs() < 0.004, "no step: {} then {}", out[19], back[0]);
    let falls = back.windows(2).all(|pair| pair[1] <= pair[0]);
    assert!(falls && (back[59] - joints[0].position).abs() < CODE, "{back:?}");

    // A message without a horizon ends the way at once.
    send(&mut robot, &moved(&joints, 0.2), ms(40));
    robot.steps(10);
    robot.send(&joints);
    robot.steps(15);
    assert_eq!(robot.joint(0).applied.position, joints[0].position);
    assert_eq!(robot.group().setpoint_horizon_ns, 0);
}

/// A joint without stiffness may be anywhere: its way begins where it is, and not at the position
/// of its last setpoint.
#[test]
fn way_of_limp_joint_begins_at_its_position() {
    let (mut robot, joints) = active();
    let limp: Vec<_> = joints.iter().map(|_| JointSetpoint { kd: 1.0, ..Default::default() }).collect();
    for _ in 0..200 {
        robot.follow(&limp);
    }
    let target: Vec<_> = joints.iter().map(|joint| JointSetpoint { position: 1.0, ..*joint }).collect();
    let measured = robot.joint(0).position;
    send(&mut robot, &target, ms(40));
    let first = positions(&mut robot, 1)[0];
    assert!((first - measured).abs() < 0.1, "{first}, at {measured}");
}

#[test]
fn setpoints_with_horizon_enable_only_near_joints() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(10);
    robot.claim().unwrap();
    let joints = robot.hold(40.0, 1.0);
    send(&mut robot, &moved(&joints, 0.5), ms(40));
    robot.step();
    let refused = robot.operate(motord_shared::Operation::Enable).unwrap_err();
    assert_eq!(refused, motord_shared::Refusal::SetpointTooFar);

    // The way of an inactive group is over at once.
    send(&mut robot, &joints, ms(40));
    robot.step();
    robot.operate(motord_shared::Operation::Enable).unwrap();
    for _ in 0..100 {
        send(&mut robot, &joints, ms(40));
        robot.step();
    }
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
}

/// Goal: whatever comes when, a command is between the command before and the setpoint, no faster
/// than the joint may be.
#[test]
fn way_stays_between_command_and_setpoint() {
    robot::for_each_seed("horizon", 50, |seed| {
        let mut random = Random::new(seed);
        let (mut robot, joints) = active();
        let [low, high] = robot.settings.motors[0].limits.position;
        let most = robot.settings.motors[0].limits.velocity * PERIOD.as_secs_f32();
        let mut target = joints[0].position;
        for cycle in 0..400 {
            if random.once_in(8) || cycle % 15 == 0 {
                let joint = JointSetpoint {
                    position: *random.pick(&[0.3, -0.3, 5.0, -5.0, f32::MAX, f32::MIN, 0.0]),
                    velocity: random.between(-1.0, 1.0),
                    torque: *random.pick(&[0.0, 1.0, f32::MAX, f32::MIN]),
                    ..joints[0]
                };
                target = joint.position.clamp(low, high);
                let horizon = Duration::from_nanos(random.draw() % 40_000_001);
                send(&mut robot, &[joint; 3], horizon);
            }
            if random.once_in(50) {
                robot.oversleep(Duration::from_micros(random.draw() % 3000));
            }
            let before = robot.joint(0).applied.position;
            robot.step();
            let now = robot.joint(0).applied.position;
            let (least, largest) = (before.min(target), before.max(target));
            assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
            assert!((least - CODE..=largest + CODE).contains(&now), "{now} between {before} and {target}");
            assert!((now - before).abs() <= 5.0 * most, "{before} to {now}");
            assert!(robot.joint(0).applied.torque.is_finite());
        }
    });
}

/// Seconds for which a stopped owner may wait before its setpoints are too old.
const LONG: Duration = Duration::from_secs(5);
/// Distance between the blocked joints and the setpoint that pulls at them, rad.
const PULLED: f32 = 0.31;

/// Ends the motion of an active group, and removes the reason.
type Stop = (&'static str, fn(&mut Robot), fn(&mut Robot));

const fn nothing(_: &mut Robot) {}

fn request(robot: &mut Robot, operation: Operation, pid: u32) {
    let lease = if pid == 0 { robot.lease() } else { 0 };
    let request = AdminRequest { operation: operation.code(), lease, pid, ..Default::default() };
    robot.ask(request).expect("the group is active");
}

/// Everything that ends the motion of a group, besides the alarms for each cause.
const STOPS: [Stop; 14] = [
    ("emergency stop", |robot| request(robot, Operation::EmergencyStop, 1), nothing),
    ("disabled by its owner", |robot| request(robot, Operation::Disable, 0), nothing),
    ("disabled by another", |robot| request(robot, Operation::Disable, 1), nothing),
    ("released", |robot| request(robot, Operation::Release, 0), nothing),
    ("taken from its owner", |robot| request(robot, Operation::ForceRelease, 1), nothing),
    (
        "its owner died",
        |robot| {
            let lease = Lease::from_raw(robot.lease()).expect("it has an owner");
            robot.client.alarms().owner_ended(lease);
        },
        nothing,
    ),
    ("its owner is silent", |robot| robot.steps(11_000), nothing),
    ("a cycle is late", |robot| robot.oversleep(ms(10)), nothing),
    ("the computer was suspended", |robot| robot.suspend(LONG), nothing),
    ("a motor is lost", |robot| robot.disturb("hip off"), |robot| robot.disturb("hip ok")),
    (
        "a motor has a fault",
        |robot| robot.disturb("hip fault 0x40"),
        |robot| {
            robot.disturb("hip ok");
            robot.operate(Operation::ClearFault).expect("the fault is over");
        },
    ),
    ("the bus is off", |robot| robot.disturb("can bus-off"), |robot| robot.disturb("can ok")),
    (
        "the bus was opened again",
        |robot| robot.disturb("can gone"),
        |robot| {
            robot.disturb("can ok");
            robot.reopen(0);
        },
    ),
    ("the bus accepts no frames", |robot| robot.disturb("can tx-full"), |robot| robot.disturb("can ok")),
];

/// Returns an active robot on the way from a setpoint that pulls at its blocked joints back to the
/// joints.
fn on_the_way(safe_stop: SafeStop) -> Robot {
    let mut settings = robot::three_motors();
    (settings.safety.setpoint_timeout, settings.safety.setpoint_horizon_max) = (LONG, LONG);
    settings.safety.damp = ms(200);
    settings.groups.iter_mut().for_each(|group| group.safe_stop = safe_stop);
    settings.motors.iter_mut().for_each(|motor| motor.limits.following_error = None);
    let mut robot = Robot::built(settings, 1, |_, motors| {
        motors.iter_mut().for_each(|motor| motor.coulomb_friction = 100.0);
    });
    let joints = robot.activate();
    let mut away = moved(&joints, PULLED);
    away.iter_mut().for_each(|joint| joint.kp = 1.0);
    (0..200).for_each(|_| robot.follow(&away));
    send(&mut robot, &joints, LONG);
    robot.steps(10);
    let joint = robot.joint(0);
    assert!((joint.applied.position - joint.position - PULLED).abs() < 0.01, "{joint:?}");
    robot
}

/// Enables the stopped group with the setpoints that it has, if the rules permit. Returns whether
/// they did.
fn enable_again(robot: &mut Robot, name: &str, restore: fn(&mut Robot)) -> bool {
    robot.steps(500);
    assert_eq!(robot.phase(), Phase::Disarmed, "{name}");
    assert_eq!(robot.group().setpoint_horizon_ns == 0, name != "its owner is silent", "{name}");
    restore(robot);
    robot.steps(500);
    if robot.cause().is_some() {
        robot.operate(Operation::Reset).unwrap_or_else(|refusal| panic!("{name}: {refusal}"));
    }
    if robot.group().lease == 0 {
        return false;
    }
    robot.operate(Operation::Enable).unwrap_or_else(|refusal| panic!("{name}: {refusal}"));
    true
}

/// Goal: whatever stops a group, its way ends: enabling it again moves no joint by more than a
/// start may. Method: the end of the way is at the joint, so only the rest of the way could move
/// it.
#[test]
fn no_way_outlives_any_stop() {
    let causes = Cause::ALL.iter().filter(|cause| **cause != Cause::Shutdown);
    for safe_stop in [SafeStop::Damp, SafeStop::Hold, SafeStop::Stop] {
        let mut continued = 0;
        for (name, stop, restore) in STOPS {
            let mut robot = on_the_way(safe_stop);
            stop(&mut robot);
            continued += u32::from(stays_near(&mut robot, name, restore));
        }
        assert_eq!(continued, 10, "the others free the group, and its setpoints with it");
        for cause in causes.clone() {
            let mut robot = on_the_way(safe_stop);
            robot.client.alarms().stop(*cause);
            assert!(stays_near(&mut robot, cause.name(), nothing), "{cause}");
        }
    }
}

/// Enables a stopped group again, and compares each command with the joint. Returns whether it
/// could be enabled.
fn stays_near(robot: &mut Robot, name: &str, restore: fn(&mut Robot)) -> bool {
    let enabled = enable_again(robot, name, restore);
    for cycle in 0..200 {
        robot.step();
        let (joint, most) = (robot.joint(0), robot.settings.safety.start_jump);
        let away = (joint.applied.position - joint.position).abs();
        let active = robot.phase() == Phase::Active;
        assert!(!active || away <= most, "{name}, cycle {cycle}: {away} rad of {most}");
    }
    assert_eq!(robot.phase() == Phase::Active, enabled, "{name}: {:?}", robot.cause());
    enabled
}
