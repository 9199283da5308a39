//! The fault catalogue, part B: faults of controllers and operators, as far as they reach the
//! cycle. `docs/faults.md` lists the item of each test.

use motord_bus::Duration;
use motord_harness::robot;
use motord_harness::robot::{Meaning, Robot};
use motord_shared::limits::{ADMINS_MAX, REQUESTS_PER_CLIENT};
use motord_shared::message::FLAG_EMERGENCY_STOP;
use motord_shared::{
    AdminRequest, Cause, JointSetpoint, Lease, Limit, MotorMode, Operation, Phase, Refusal, Rejection,
    SetpointMessage,
};

fn active() -> (Robot, Vec<JointSetpoint>) {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let joints = robot.activate();
    (robot, joints)
}

fn rejected(robot: &mut Robot, rejection: Rejection) -> u32 {
    robot.group().rejected[rejection.code() as usize]
}

/// Sends `message` and runs a cycle. It must be rejected for this reason, and the previous setpoint
/// must stay in use.
fn must_reject(robot: &mut Robot, message: &SetpointMessage, reason: Rejection) {
    let (before, accepted) = (rejected(robot, reason), robot.group().accepted);
    robot.deliver(message);
    robot.step();
    assert_eq!(rejected(robot, reason) - before, 1, "{reason}: {message:?}");
    assert_eq!((robot.group().accepted, robot.phase()), (accepted, Phase::Active), "{reason}");
}

#[test]
fn silent_owner_stops_group_after_20_ms() {
    let (mut robot, joints) = active();
    robot.send(&joints);
    let last = robot.now();
    while robot.cause().is_none() {
        robot.step();
    }
    let begun = robot.state().tick_ns - last.as_nanos();
    assert!(
        (20_000_000..=21_000_000).contains(&begun),
        "stopped in the cycle {begun} ns after the last message"
    );
    robot.take_sent();
    for _ in 0..200 {
        robot.follow(&joints);
    }
    assert_eq!(robot.cause(), Some(Cause::SetpointTimeout));
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()), "new messages do not resume it");
}

/// Reports to the cycle that the process with `lease` has exited, as the daemon does.
fn dies(robot: &mut Robot, lease: u64) {
    robot.client.alarms().owner_ended(Lease::from_raw(lease).expect("it owns the group"));
    robot.step();
}

/// Resets the group when it is at rest, and makes it follow setpoints again.
fn activate_again(robot: &mut Robot) -> Vec<JointSetpoint> {
    while robot.phase() != Phase::Disarmed {
        robot.step();
    }
    robot.operate(Operation::Reset).expect("a group at rest can be reset");
    robot.activate()
}

#[test]
fn dead_owner_stops_group_in_next_cycle() {
    let (mut robot, joints) = active();
    let lease = robot.lease();
    robot.take_sent();
    dies(&mut robot, lease);
    assert_eq!((robot.phase(), robot.cause()), (Phase::Damping, Some(Cause::OwnerDied)));
    assert_eq!(robot.group().lease, 0, "the group is free for the next controller");
    for _ in 0..200 {
        robot.follow(&joints);
    }
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()), "what it sent before moves nothing");
    assert_eq!(robot.cause(), Some(Cause::OwnerDied));
}

/// A late report of the kernel, or a reused process id, does not stop a healthy robot.
#[test]
fn death_of_former_owner_stops_no_group() {
    let (mut robot, _) = active();
    let first = robot.lease();
    dies(&mut robot, first);
    let joints = activate_again(&mut robot);
    assert_ne!(robot.lease(), first);
    dies(&mut robot, first);
    robot.follow(&joints);
    assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None));
}

#[test]
fn death_of_resting_owner_frees_group_without_stop() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(10);
    let lease = robot.claim().expect("nobody owns the group");
    dies(&mut robot, lease);
    assert_eq!((robot.phase(), robot.cause(), robot.group().lease), (Phase::Disarmed, None, 0));
}

#[test]
fn unreachable_daemon_stops_groups_with_first_cause() {
    for leaves in [false, true] {
        let (mut robot, joints) = active();
        robot.client.alarms().stop(Cause::DirectoryLost);
        if leaves {
            robot.cycle.shut_down();
        }
        robot.take_sent();
        robot.follow(&joints);
        assert_eq!((robot.phase(), robot.cause()), (Phase::Damping, Some(Cause::DirectoryLost)));
        assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()));
        let joints = (!leaves).then(|| activate_again(&mut robot));
        assert!(joints.is_none_or(|_| robot.cause().is_none()), "it is reported once");
    }
}

#[test]
fn required_switch_absent_stops_robot_until_it_returns() {
    let (mut robot, joints) = active();
    robot.client.alarms().stand(Some(Cause::SwitchLost));
    robot.take_sent();
    robot.follow(&joints);
    assert_eq!((robot.phase(), robot.cause()), (Phase::Damping, Some(Cause::SwitchLost)));
    while robot.phase() != Phase::Disarmed {
        robot.step();
    }
    robot.operate(Operation::Reset).expect("a group at rest can be reset");
    robot.follow(&joints);
    let enable =
        AdminRequest { operation: Operation::Enable.code(), lease: robot.lease(), ..Default::default() };
    robot.ask(enable).expect("nothing else is wrong");
    for _ in 0..200 {
        robot.follow(&joints);
        assert_ne!(robot.phase(), Phase::Active);
    }
    assert_eq!(robot.cause(), Some(Cause::SwitchLost));
    robot.client.alarms().stand(None);
    // Long enough that its owner has exited.
    robot.steps(2000);
    activate_again(&mut robot);
}

#[test]
fn short_pause_is_tolerated_and_queued_messages_dropped() {
    let (mut robot, joints) = active();
    robot.steps(10);
    robot.follow(&joints);
    assert_eq!(robot.phase(), Phase::Active, "10 ms are within the timeout");

    let queued = robot.message(&joints);
    robot.steps(500);
    assert_eq!(robot.cause(), Some(Cause::SetpointTimeout));
    robot.deliver(&queued);
    robot.steps(2);
    assert_eq!(rejected(&mut robot, Rejection::WrongLease), 1, "its lease ended with its silence");
    assert_eq!(robot.phase(), Phase::Disarmed);
}

#[test]
fn a_message_from_before_the_timeout_is_stale() {
    let (mut robot, joints) = active();
    let mut message = robot.message(&joints);
    message.time_ns -= 20_500_000;
    must_reject(&mut robot, &message, Rejection::Stale);
}

/// The five values of a joint's setpoint.
fn value(joint: &mut JointSetpoint, field: usize) -> &mut f32 {
    let JointSetpoint { position, velocity, kp, kd, torque, .. } = joint;
    [position, velocity, kp, kd, torque].into_iter().nth(field).expect("there are five")
}

#[test]
fn one_nonfinite_value_rejects_the_whole_message() {
    let (mut robot, joints) = active();
    for (joint, field) in (0..3).flat_map(|joint| (0..5).map(move |field| (joint, field))) {
        for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut corrupted = robot.message(&joints);
            *value(&mut corrupted.joints[joint], field) = odd;
            must_reject(&mut robot, &corrupted, Rejection::NotFinite);
            for sent in robot.take_sent() {
                let Meaning::Control { torque, .. } = sent.meaning else { continue };
                assert!(
                    torque.abs() < 0.2,
                    "the valid setpoint before is still followed: {:?}",
                    sent.meaning
                );
            }
            robot.follow(&joints);
        }
    }
    assert_eq!(rejected(&mut robot, Rejection::NotFinite), 45);
}

#[test]
fn the_smallest_numbers_and_negative_zero_are_numbers() {
    let (mut robot, joints) = active();
    for (field, odd) in
        (0..5).flat_map(|field| [1e-45, f32::MIN_POSITIVE / 2.0, -0.0].map(|odd| (field, odd)))
    {
        let mut joints = joints.clone();
        *value(&mut joints[1], field) = odd;
        for _ in 0..100 {
            robot.follow(&joints);
        }
        assert_eq!(robot.phase(), Phase::Active, "{odd} in field {field}");
        assert!(robot.take_sent().iter().all(|sent| sent.bytes != [0; 8]));
    }
}

/// A slew and the ramp of the start are no clamp.
#[test]
fn cycles_with_clamped_values_are_counted_by_joint() {
    let (mut robot, joints) = active();
    (0..100).for_each(|_| robot.follow(&joints));
    let counts = |robot: &mut Robot| [0, 1, 2].map(|joint| robot.joint(joint).clamped);
    assert_eq!(counts(&mut robot), [0; 3]);
    let limits = robot.settings.motors[1].limits.clone();
    for (field, end) in [limits.position[1], limits.velocity, limits.kp, limits.kd].into_iter().enumerate() {
        let before = counts(&mut robot);
        let mut far = joints.clone();
        *value(&mut far[1], field) = 1.01 * end;
        (0..5).for_each(|_| robot.follow(&far));
        assert_eq!(counts(&mut robot), [0, before[1] + 5, 0], "field {field}");
    }
    // A position without stiffness has no effect.
    let before = counts(&mut robot);
    let limp = JointSetpoint { position: 2.0 * limits.position[1], kp: 0.0, ..joints[1] };
    (0..100).for_each(|_| robot.follow(&[joints[0], limp, joints[2]]));
    assert!(robot.joint(1).limits & Limit::Position.bit() != 0 && robot.phase() == Phase::Active);
    let after = counts(&mut robot);
    assert!(after[1] - before[1] < 100, "only until the stiffness has fallen: {before:?}, {after:?}");
}

#[test]
fn value_beyond_range_is_clamped_alone() {
    for (field, factor) in (0..5).flat_map(|field| [1.0001, 10.0, f32::MAX].map(|factor| (field, factor))) {
        let (mut robot, joints) = active();
        let limits = robot.settings.motors[1].limits.clone();
        let ends = [limits.position[1], limits.velocity, limits.kp, limits.kd, limits.torque];
        let mut far = joints.clone();
        let wanted = if factor == f32::MAX { f32::MAX } else { ends[field] * factor };
        *value(&mut far[1], field) = wanted;
        robot.follow(&joints);
        robot.take_sent();
        robot.follow(&far);
        let Some(Meaning::Control { position, velocity, kp, kd, torque, .. }) =
            robot.take_sent_to(2).first().map(|sent| sent.meaning)
        else {
            panic!("it is controlled")
        };
        let sent = [position, velocity, kp, kd, torque];
        let asked = [joints[1].position, 0.0, 40.0, 1.0, 0.0].map(f64::from);
        let codes = [4e-4, 0.033, 0.13, 0.002, 0.12];
        for other in (0..5).filter(|other| *other != field) {
            // A large value may make the bound on the total torque scale the others down in common,
            // never up.
            let excess = sent[other].abs() - asked[other].abs();
            assert!(
                excess <= codes[other],
                "field {field} × {factor} changed field {other} to {}",
                sent[other]
            );
        }
        assert!(sent[field].abs() <= f64::from(ends[field]) + codes[field]);
    }
}

#[test]
fn extreme_values_never_form_special_frames() {
    for sign in [1.0, -1.0] {
        let (mut robot, mut joints) = active();
        for joint in &mut joints {
            (joint.position, joint.velocity, joint.torque) =
                (sign * f32::MAX, sign * f32::MAX, sign * f32::MAX);
            (joint.kp, joint.kd) = if sign > 0.0 { (f32::MAX, f32::MAX) } else { (0.0, 0.0) };
        }
        robot.take_sent();
        for _ in 0..300 {
            robot.follow(&joints);
        }
        let sent = robot.take_sent();
        assert!(
            sent.iter()
                .all(|sent| sent.bytes != [0; 8] && sent.bytes[..6] != [255; 6] || sent.meaning.is_safe())
        );
        assert!(sent.iter().all(|sent| sent.meaning != Meaning::Start && sent.meaning != Meaning::SetZero));
    }
}

#[test]
fn step_of_stiffness_or_torque_becomes_slope() {
    let (mut robot, joints) = active();
    let limits = robot.settings.motors[0].limits.clone();
    let mut step = joints.clone();
    (step[0].kp, step[0].torque) = (limits.kp, limits.torque);
    robot.take_sent();
    for _ in 0..20 {
        robot.follow(&step);
    }
    let sent = robot.take_sent_to(1);
    let Meaning::Control { kp: first, torque: from, .. } = sent[0].meaning else {
        panic!("it is controlled")
    };
    for (cycle, sent) in sent.iter().enumerate() {
        let Meaning::Control { kp, torque, .. } = sent.meaning else { panic!("it is controlled") };
        let time = cycle as f64 / 1000.0;
        assert!(kp - first <= f64::from(limits.kp_slew) * time + 0.13, "kp {kp} after {cycle} cycles");
        assert!(
            torque - from <= f64::from(limits.torque_slew) * time + 0.23,
            "{torque} N·m after {cycle} cycles"
        );
    }
}

#[test]
fn second_controller_is_refused_without_disturbing_owner() {
    let (mut robot, joints) = active();
    let owner = robot.lease();
    assert_eq!(robot.operate(Operation::Claim).unwrap_err(), Refusal::Owned);
    for _ in 0..100 {
        let mut wrong = robot.message(&joints);
        wrong.lease ^= 1 << 40;
        wrong.joints[0].position += 1.0;
        must_reject(&mut robot, &wrong, Rejection::WrongLease);
        robot.follow(&joints);
    }
    assert_eq!((robot.group().lease, robot.phase()), (owner, Phase::Active));
}

#[test]
fn old_lease_moves_nothing_after_succession() {
    let (mut robot, joints) = active();
    let old = robot.message(&joints);
    robot.steps(22);
    let lease = robot.claim().expect("nobody owns the group");
    assert_ne!(lease, old.lease);
    assert!(lease >> 8 > old.lease >> 8, "epochs rise");
    robot.follow(&joints);
    assert_eq!(robot.operate(Operation::Enable).unwrap_err(), Refusal::Latched);
    robot.deliver(&SetpointMessage { time_ns: robot.now().as_nanos(), ..old });
    robot.step();
    assert!(rejected(&mut robot, Rejection::WrongLease) >= 1);
    for _ in 0..3000 {
        robot.follow(&joints);
    }
    robot.operate(Operation::Reset).expect("a group at rest can be reset");
    robot.activate();
}

/// Goal: a successor that takes over a moving robot as early as it may gives its motors no jolt.
/// Method: the owner dies while its joints turn. The successor asks for everything in each cycle,
/// and holds the joints where they are. The joints must rest when they start, and stay slow.
#[test]
fn hand_over_in_motion_waits_for_rest() {
    let (mut robot, joints) = active();
    for cycle in 0..200_u8 {
        let turned = |joint: &JointSetpoint| JointSetpoint {
            position: joint.position + 0.002 * f32::from(cycle),
            velocity: 2.0,
            ..*joint
        };
        robot.follow(&joints.iter().map(turned).collect::<Vec<_>>());
    }
    let speed = |robot: &mut Robot| (0..3).map(|joint| robot.joint(joint).velocity.abs()).fold(0.0, f32::max);
    assert!(speed(&mut robot) > 1.0, "they turn");
    let lease = robot.lease();
    dies(&mut robot, lease);
    robot.take_sent();
    robot.claim().unwrap();
    let tries = |robot: &mut Robot| {
        let held = robot.hold(40.0, 1.0);
        robot.follow(&held);
        let _refused = robot.operate(Operation::Reset);
        robot.operate(Operation::Enable).is_ok()
    };
    let waited = (0..5000).take_while(|_| !tries(&mut robot)).count();
    assert!((10..5000).contains(&waited), "{waited} cycles");
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()), "nothing moves before");
    let held = robot.hold(40.0, 1.0);
    for _ in 0..500 {
        robot.follow(&held);
        assert!(speed(&mut robot) < 0.5, "{:?} {}", robot.phase(), speed(&mut robot));
    }
    assert_eq!(robot.phase(), Phase::Active);
}

#[test]
fn message_for_wrong_joints_or_mode_is_rejected() {
    let (mut robot, joints) = active();
    for count in [0, 2, 4, 64, 65, u32::MAX] {
        let message = SetpointMessage { joint_count: count, ..robot.message(&joints) };
        must_reject(&mut robot, &message, Rejection::JointCount);
        robot.follow(&joints);
    }
    for mode in [1, 2, 3, 4, u32::MAX] {
        let mut message = robot.message(&joints);
        message.joints[2].mode = mode;
        must_reject(&mut robot, &message, Rejection::Mode);
        robot.follow(&joints);
    }
    for field in [2, 3] {
        let mut message = robot.message(&joints);
        *value(&mut message.joints[0], field) = -1.0;
        must_reject(&mut robot, &message, Rejection::Negative);
        robot.follow(&joints);
    }
}

#[test]
fn stale_sequence_and_foreign_time_are_rejected() {
    let (mut robot, joints) = active();
    let used = robot.message(&joints);
    robot.deliver(&used);
    robot.step();
    for sequence in [used.sequence, used.sequence - 1, 0, used.sequence + (1 << 63), u64::MAX] {
        let message = SetpointMessage { sequence, ..robot.message(&joints) };
        must_reject(&mut robot, &message, Rejection::Sequence);
        robot.follow(&joints);
    }
    let wall_clock = 1_780_000_000_000_000_000;
    for time_ns in [robot.now().as_nanos() + 2_500_000, wall_clock, u64::MAX] {
        let message = SetpointMessage { time_ns, ..robot.message(&joints) };
        must_reject(&mut robot, &message, Rejection::FromFuture);
        robot.follow(&joints);
    }
}

#[test]
fn newest_of_many_messages_is_used() {
    let (mut robot, joints) = active();
    let accepted = robot.group().accepted;
    for _ in 0..100 {
        (0..20).for_each(|_| robot.send(&joints));
        robot.step();
    }
    let group = robot.group();
    assert_eq!((group.accepted - accepted, robot.phase()), (100, Phase::Active));
    assert_eq!(group.sequence, robot.message(&joints).sequence - 1);
}

/// Most requests that all clients together may have in flight.
const AT_ONCE: usize = ADMINS_MAX * REQUESTS_PER_CLIENT;

#[test]
fn emergency_stop_overtakes_all_other_requests() {
    let (mut robot, joints) = active();
    for _ in 1..AT_ONCE {
        robot.post(AdminRequest { operation: u32::MAX, ..Default::default() });
    }
    robot.post(AdminRequest { operation: Operation::EmergencyStop.code(), ..Default::default() });
    robot.follow(&joints);
    assert_ne!(robot.state().flags & FLAG_EMERGENCY_STOP, 0);
}

#[test]
fn senseless_requests_are_answered_few_per_cycle() {
    let (mut robot, joints) = active();
    let mut answers = 0;
    for cycle in 0..200_u32 {
        for code in 0..80 {
            let operation = if code < 40 { 1000 + code } else { cycle.wrapping_mul(2_654_435_761) };
            robot.post(AdminRequest {
                operation,
                group: u32::MAX - 1,
                joint: 77,
                lease: 1,
                ..Default::default()
            });
        }
        robot.follow(&joints);
        let mut in_this_cycle = 0;
        while let Some((_, reply)) = robot.take_answer() {
            assert_ne!(reply.refusal, 0, "none of them makes sense");
            in_this_cycle += 1;
        }
        assert!(in_this_cycle <= AT_ONCE);
        answers += in_this_cycle;
    }
    assert_eq!((answers, robot.phase()), (200 * AT_ONCE, Phase::Active));
}

/// Requests an enable, and returns the refusal.
fn refused_enable(robot: &mut Robot) -> Refusal {
    robot.operate(Operation::Enable).expect_err("something is wrong")
}

#[test]
fn group_is_enabled_only_when_all_healthy() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(10);
    assert_eq!(refused_enable(&mut robot), Refusal::NoOwner);
    robot.claim().unwrap();
    assert_eq!(refused_enable(&mut robot), Refusal::NoSetpoint);
    let joints = robot.hold(40.0, 1.0);
    robot.follow(&joints);
    let request = AdminRequest { operation: Operation::Enable.code(), lease: 77, ..Default::default() };
    assert_eq!(robot.ask(request).unwrap_err(), Refusal::NotOwner);
    robot.disturb("hip off");
    for _ in 0..3 {
        robot.follow(&joints);
    }
    assert_eq!(refused_enable(&mut robot), Refusal::StateStale);
    robot.follow_until(&joints, 20, |robot| robot.mode(0) == MotorMode::Offline);
    assert_eq!(refused_enable(&mut robot), Refusal::MotorOffline);
    robot.disturb("hip ok");
    robot.disturb("knee fault 0x40");
    robot.follow_until(&joints, 400, |robot| {
        robot.mode(2) == MotorMode::Fault && robot.mode(0) == MotorMode::Idle
    });
    assert_eq!(refused_enable(&mut robot), Refusal::MotorFault);
    robot.disturb("can down");
    robot.follow(&joints);
    assert_eq!(refused_enable(&mut robot), Refusal::BusDown);
    robot.operate(Operation::EmergencyStop).unwrap();
    assert_eq!(refused_enable(&mut robot), Refusal::EmergencyStopActive);
}

#[test]
fn moving_motor_is_never_written_to() {
    let (mut robot, joints) = active();
    robot.send(&joints);
    for operation in [Operation::SetZero, Operation::ClearFault] {
        let request = AdminRequest { operation: operation.code(), joint: 1, ..Default::default() };
        assert_eq!(robot.ask(request).unwrap_err(), Refusal::NotDisarmed);
    }
    assert_eq!(robot.operate(Operation::Enable).unwrap_err(), Refusal::NotDisarmed);
    assert_eq!(robot.operate(Operation::Reset).unwrap_err(), Refusal::NotNeutral);
    assert!(
        robot
            .take_sent()
            .iter()
            .all(|sent| matches!(sent.meaning, Meaning::Control { .. } | Meaning::GetFault))
    );
}

#[test]
fn released_or_revoked_group_is_damped() {
    for forced in [false, true] {
        let (mut robot, joints) = active();
        robot.send(&joints);
        robot.take_sent();
        let operation = if forced { Operation::ForceRelease } else { Operation::Release };
        robot
            .ask(AdminRequest { operation: operation.code(), lease: robot.lease(), ..Default::default() })
            .unwrap();
        robot.deliver(&robot::message(robot.lease(), 1 << 20, robot.now(), &joints));
        robot.steps(2);
        assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()));
        assert_eq!(
            (robot.group().lease, robot.cause().is_some()),
            (0, forced),
            "only what was forced is latched"
        );
        robot.steps(Duration::from_secs(3).as_millis() as usize);
        assert_eq!(robot.phase(), Phase::Disarmed);
    }
}
