//! The cycle with simulated motors, on virtual time.

use super::family;
use motord_bus::Duration;
use motord_core::control::Event;
use motord_harness::robot;
use motord_harness::robot::{Meaning, Robot};
use motord_shared::{AdminRequest, Cause, JointSetpoint, MotorMode, Operation, Phase, Refusal};

#[test]
fn stopped_motors_receive_only_stops_and_questions() {
    let mut robot = Robot::new(robot::quadruped(), 1);
    robot.steps(1000);
    assert!((0..12).all(|joint| robot.mode(joint) == MotorMode::Idle));
    assert!((0..12).all(|joint| robot.joint(joint).age_cycles == 0 && robot.joint(joint).missed == 0));
    let sent = robot.take_sent();
    assert!(sent.iter().all(|sent| matches!(sent.meaning, Meaning::Stop | Meaning::GetFault)));
    let stops = sent.iter().filter(|sent| sent.meaning == Meaning::Stop).count();
    assert_eq!(stops, 12 * 1000, "each motor once in each cycle");
}

#[test]
fn motors_are_asked_for_faults_at_10_hz() {
    let mut robot = Robot::new(robot::quadruped(), 1);
    robot.steps(2000);
    robot.take_sent();
    robot.steps(1000);
    let sent = robot.take_sent();
    for bus in 0..4 {
        for id in 1..=3 {
            let polls =
                sent.iter().filter(|sent| (sent.bus, sent.id, sent.meaning) == (bus, id, Meaning::GetFault));
            let polls = polls.count();
            assert!((9..=11).contains(&polls), "bus {bus} motor {id} was asked {polls} times");
        }
    }
}

#[test]
fn group_starts_neutral_then_ramps_gains() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(10);
    robot.claim().unwrap();
    let joints = robot.hold(40.0, 1.0);
    robot.follow(&joints);
    robot.take_sent();
    robot.operate(Operation::Enable).unwrap();
    for _ in 0..300 {
        robot.follow(&joints);
    }
    assert_eq!(robot.phase(), Phase::Active);

    let sent: Vec<_> = robot.take_sent().into_iter().filter(|sent| sent.id == 1).collect();
    let start = sent.iter().position(|sent| sent.meaning == Meaning::Start).expect("it is started");
    assert!(
        sent[start - 1].meaning.is_safe() && !matches!(sent[start - 1].meaning, Meaning::Stop),
        "neutral before start"
    );
    assert_eq!(sent.iter().filter(|sent| sent.meaning == Meaning::Start).count(), 1);
    let stiffness: Vec<_> = sent[start + 1..]
        .iter()
        .filter_map(|sent| match sent.meaning {
            Meaning::Control { kp, .. } => Some((sent.at, kp)),
            _ => None,
        })
        .collect();
    let first = stiffness.iter().find(|(_, kp)| *kp > 0.0).expect("it gets stiff").0;
    let full = stiffness.iter().find(|(_, kp)| *kp > 39.9).expect("it gets as stiff as asked").0;
    assert!(full.since(first) >= Duration::from_millis(95), "from {first:?} to {full:?}");
    assert!(stiffness.is_sorted_by(|a, b| a.1 <= b.1), "never down");
}

#[test]
fn distant_setpoint_is_refused_before_motion() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(10);
    robot.claim().unwrap();
    let mut joints = robot.hold(40.0, 1.0);
    joints[1].position += 0.5;
    robot.follow(&joints);
    assert_eq!(robot.operate(Operation::Enable).unwrap_err(), Refusal::SetpointTooFar);
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()));
}

#[test]
fn dead_controller_leaves_joints_damped_then_stopped() {
    let mut robot = Robot::new(robot::quadruped(), 1);
    let joints = robot.activate();
    robot.follow(&joints);
    let last = robot.now();
    robot.steps(22);
    assert_eq!((robot.phase(), robot.cause()), (Phase::Damping, Some(Cause::SetpointTimeout)));
    let sent = robot.take_sent();
    let late = last + Duration::from_millis(20);
    assert!(sent.iter().filter(|sent| sent.at > late).count() >= 12);
    assert!(sent.iter().filter(|sent| sent.at > late).all(|sent| sent.meaning.is_safe()));

    robot.steps(3000);
    assert_eq!(robot.phase(), Phase::Disarmed);
    assert_eq!(
        robot.operate(Operation::Enable).unwrap_err(),
        Refusal::Latched,
        "it never starts again by itself"
    );
    robot.operate(Operation::Reset).unwrap();
    robot.activate();
}

#[test]
fn setpoint_timeout_reports_period_of_owner() {
    for every in [1, 5, 18] {
        let mut robot = Robot::new(robot::three_motors(), 1);
        let joints = robot.activate();
        for _ in 0..60 {
            robot.follow(&joints);
            robot.steps(every - 1);
        }
        let published = robot.group().setpoint_period_ns as f64 / 1e6;
        assert!((published - every as f64).abs() < 0.1, "{every}: {published}");
        robot.take_events();
        robot.steps(22);
        assert_eq!(robot.cause(), Some(Cause::SetpointTimeout));
        let events = robot.take_events();
        let period = events.iter().find_map(|event| match event {
            Event::SetpointPeriod { period, .. } => Some(period.as_secs_f64() * 1e3),
            _ => None,
        });
        assert!(period.is_some_and(|period| (period - every as f64).abs() < 0.1), "{every}: {period:?}");
        let published = robot.group().setpoint_period_ns as f64 / 1e6;
        assert!((published - every as f64).abs() < 0.1, "{every}: {published}, also after the stop");
    }
}

#[test]
fn lost_motor_stops_group_until_reset() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let joints = robot.activate();
    robot.disturb("thigh off");
    for _ in 0..11 {
        robot.follow(&joints);
    }
    assert_eq!((robot.mode(1), robot.phase()), (MotorMode::Offline, Phase::Damping));
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::MotorLost), 1));
    robot.steps(3000);
    robot.disturb("thigh ok");
    robot.take_sent();
    robot.steps(500);
    assert_eq!((robot.mode(1), robot.phase()), (MotorMode::Idle, Phase::Disarmed));
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()), "no start is sent by itself");
}

#[test]
fn every_fault_bit_stops_group_and_no_position() {
    for bit in 0..8 {
        let mut robot = Robot::new(robot::three_motors(), 1);
        let joints = robot.activate();
        let before = robot.joint(2).position;
        robot.disturb(&format!("knee fault {:#04x}", 1 << bit));
        for _ in 0..150 {
            robot.follow(&joints);
            let joint = robot.joint(2);
            assert!(joint.position.is_nan() || (joint.position - before).abs() < 0.05, "{}", joint.position);
        }
        assert_eq!((robot.mode(2), robot.joint(2).fault), (MotorMode::Fault, 1 << bit), "bit {bit}");
        assert_eq!(robot.cause(), Some(Cause::MotorFault), "bit {bit}");
        robot.steps(2500);
        assert_eq!(robot.operate(Operation::Reset).unwrap_err(), Refusal::MotorFault);
        let clear = motord_shared::AdminRequest {
            operation: Operation::ClearFault.code(),
            joint: 2,
            ..Default::default()
        };
        robot.ask(clear).unwrap();
        robot.operate(Operation::Reset).unwrap();
        robot.activate();
    }
}

#[test]
fn late_wakeup_skips_to_grid_with_one_batch() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let joints = robot.activate();
    let (before, tick_ns) = (robot.state().cycle, robot.state().tick_ns);
    robot.send(&joints);
    robot.take_sent();
    robot.oversleep(Duration::from_micros(10_300));
    robot.step();
    let state = robot.state();
    assert_eq!((state.cycle - before, state.overruns), (11, 10), "ten ticks were missed");
    assert_eq!(state.tick_ns - tick_ns, 11_000_000, "the time is that of the cycle's number");
    assert_eq!(state.wake_latency_ns, 300_000, "and the delay is after it");
    assert_eq!(robot.take_sent().len(), 3, "no burst");
    assert_eq!((robot.phase(), robot.cause()), (Phase::Damping, Some(Cause::TimeBase)));
}

#[test]
fn late_setpoint_is_counted_and_dated() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let joints = robot.activate();
    let mut used = |answered: u64, oversleep: u64| {
        let (before, late) = (robot.state().cycle, robot.group().late);
        // Relative to the newest states; 0 and a future cycle have no meaning.
        let answers = if answered == 0 { 0 } else { before + 2 - answered };
        let message = motord_shared::SetpointMessage { cycle: answers, ..robot.message(&joints) };
        robot.deliver(&message);
        robot.oversleep(Duration::from_micros(1000 * oversleep));
        robot.step();
        let group = robot.group();
        assert_eq!(group.used_cycle, robot.state().cycle, "it is in use");
        robot.step();
        assert_eq!(robot.group().used_cycle, group.used_cycle, "the first cycle counts");
        (
            group.answered_cycle,
            group.late - late,
            group.used_cycle.saturating_sub(group.answered_cycle),
            answers,
        )
    };
    for (answered, oversleep, is_known, late, cycles) in
        [(2, 0, true, 0, 1), (3, 0, true, 1, 2), (5, 0, true, 1, 4), (2, 3, true, 0, 4), (3, 3, true, 1, 5)]
    {
        let (known, counted, latency, answers) = used(answered, oversleep);
        assert_eq!((known == answers, counted, latency), (is_known, late, cycles), "{answered}, {oversleep}");
    }
    for unknown in [0, 1] {
        let (answered, late, ..) = used(unknown, 0);
        assert_eq!((answered, late), (0, 0), "{unknown}");
    }
}

#[test]
fn set_zero_needs_stopped_motor_and_confirming_position() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let request =
        motord_shared::AdminRequest { operation: Operation::SetZero.code(), joint: 0, ..Default::default() };
    robot.activate();
    assert_eq!(robot.ask(request).unwrap_err(), Refusal::NotDisarmed);
    robot.steps(3000);
    robot.ask(request).unwrap();
    robot.step();
    assert!(robot.joint(0).position.abs() < 0.01);
}

#[test]
fn emergency_stop_acts_in_its_cycle_and_latches() {
    let mut robot = Robot::new(robot::quadruped(), 1);
    robot.activate();
    robot.take_sent();
    robot.operate(Operation::EmergencyStop).unwrap();
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()));
    robot.steps(3000);
    assert_eq!(robot.operate(Operation::Enable).unwrap_err(), Refusal::EmergencyStopActive);
    robot.operate(Operation::Reset).unwrap();
    robot.activate();
}

#[test]
fn late_states_after_stall_are_no_faults() {
    for delay in 2..=9 {
        let mut robot = Robot::new(robot::three_motors(), delay);
        let joints = robot.activate();
        robot.disturb(&format!("thigh delayed {delay}ms"));
        for _ in 0..20 {
            robot.follow(&joints);
        }
        robot.disturb("thigh ok");
        for _ in 0..300 {
            robot.follow(&joints);
            assert_eq!(robot.joint(1).fault, 0, "delayed by {delay} ms");
            let cause = robot.cause();
            assert!(
                !matches!(cause, Some(Cause::MotorFault | Cause::DuplicateId)),
                "{cause:?}, delayed by {delay} ms"
            );
        }
    }
}

/// Goal: the answers that were pending for longer than any reply is expected to take are late, not
/// those of a second motor. Method: the answers are so long behind that no miss is remembered; then
/// all of them arrive beside the timely ones.
#[test]
fn burst_of_pending_answers_is_no_duplicate() {
    for delay in [7, 9, 60, 120] {
        let mut robot = Robot::new(robot::three_motors(), delay);
        let joints = robot.activate();
        robot.disturb(&format!("thigh delayed {delay}ms"));
        for _ in 0..500 {
            robot.follow(&joints);
        }
        let missed = robot.joint(1).missed;
        robot.disturb("thigh ok");
        for _ in 0..300 {
            robot.follow(&joints);
            assert_ne!(robot.cause(), Some(Cause::DuplicateId), "delayed by {delay} ms, missed {missed}");
        }
        assert_eq!(robot.bus(0).duplicate, 0, "delayed by {delay} ms, missed {missed}");
    }
}

/// Goal: the same at a low rate, where each request is older than any reply is expected to be when
/// the next is sent.
#[test]
fn burst_at_low_rate_is_no_duplicate() {
    let mut robot = Robot::new(family::motors_at(family::MIT, 3, 10), 1);
    robot.steps(50);
    robot.disturb("joint2 delayed 350ms");
    robot.steps(20);
    robot.disturb("joint2 ok");
    robot.steps(20);
    assert_eq!(robot.bus(0).duplicate, 0);
}

/// Returns a robot whose thigh answers every request one cycle late, until no miss is remembered.
fn lagging_by_a_cycle() -> (Robot, Vec<JointSetpoint>) {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let joints = robot.activate();
    robot.disturb("thigh delayed 1ms");
    for _ in 0..200 {
        robot.follow(&joints);
    }
    (robot, joints)
}

#[test]
fn states_lagging_by_a_cycle_stop_nothing() {
    let (mut robot, joints) = lagging_by_a_cycle();
    for verb in ["thigh delayed 1ms", "thigh ok"] {
        robot.disturb(verb);
        for _ in 0..1000 {
            robot.follow(&joints);
            assert_eq!((robot.joint(1).fault, robot.phase()), (0, Phase::Active), "{:?}", robot.cause());
        }
    }
}

#[test]
fn fault_is_known_although_answers_lag() {
    for bits in [0x01, 0x40, 0x80] {
        let (mut robot, joints) = lagging_by_a_cycle();
        robot.disturb(&format!("thigh fault {bits:#x}"));
        robot.follow_until(&joints, 500, |robot| robot.cause().is_some());
        assert_eq!((robot.cause(), robot.joint(1).fault), (Some(Cause::MotorFault), bits));
    }
}

/// Goal: a lost motor that is found by late answers is not treated as faulty, which only an
/// operator could clear.
/// Method: its answers are so late that those to other requests meet the fault request.
#[test]
fn late_states_of_lost_motor_are_no_faults() {
    for delay in [60, 110, 250, 333, 410, 450, 505] {
        let mut robot = Robot::new(robot::three_motors(), delay);
        let joints = robot.activate();
        for verb in [format!("thigh delayed {delay}ms"), "thigh ok".into()] {
            robot.disturb(&verb);
            for _ in 0..2000 {
                robot.follow(&joints);
                assert_eq!(robot.joint(1).fault, 0, "delayed by {delay} ms");
            }
        }
        assert_eq!(robot.mode(1), MotorMode::Idle, "delayed by {delay} ms");
    }
}

/// Goal: a panic in the cycle does not leave motors with their last command.
/// Method: the clock panics in mid-cycle, and the test then does what the daemon's thread does.
#[test]
fn panic_in_cycle_damps_then_stops_joints() {
    let mut robot = Robot::new(robot::quadruped(), 1);
    let joints = robot.activate();
    robot.follow(&joints);
    robot.take_sent();
    robot.clock.broken.set(true);
    let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| robot.step()));
    assert!(panicked.is_err());
    let begun = robot.now();
    robot.cycle.stop_after_panic();
    for bus in 0..4 {
        robot.collect_record(bus);
    }
    let sent = robot.take_sent();
    assert!(sent.iter().all(|sent| sent.meaning.is_safe()));
    for (bus, id) in (0..4).flat_map(|bus| (1..=3).map(move |id| (bus, id))) {
        let received: Vec<_> = sent.iter().filter(|sent| (sent.bus, sent.id) == (bus, id)).collect();
        let (first, last) =
            (received.first().expect("each motor hears it"), received.last().expect("each motor hears it"));
        assert!(matches!(first.meaning, Meaning::Control { kd, .. } if kd > 0.0));
        assert!(first.at.since(begun) < Duration::from_millis(2));
        assert_eq!(last.meaning, Meaning::Stop);
    }
}

#[test]
fn joint_outside_limits_is_not_enabled() {
    let mut settings = robot::three_motors();
    settings.simulation[1].initial_position = 4.5;
    let mut robot = Robot::new(settings, 1);
    robot.steps(10);
    robot.claim().unwrap();
    let joints = robot.hold(40.0, 1.0);
    robot.follow(&joints);
    assert_eq!(robot.operate(Operation::Enable).unwrap_err(), Refusal::OutsideLimits);
}

#[test]
fn disable_latches_only_when_not_by_owner() {
    let disable = |pid| AdminRequest { operation: Operation::Disable.code(), pid, ..Default::default() };
    let mut robot = Robot::new(robot::three_motors(), 1);
    let joints = robot.activate();
    robot.ask(disable(0)).unwrap();
    assert_eq!(robot.cause(), None, "the owner claimed as the same process");
    robot.follow_until(&joints, 3000, |robot| robot.phase() == Phase::Disarmed);
    robot.operate(Operation::Enable).unwrap();

    robot.ask(disable(123)).unwrap();
    assert_eq!((robot.cause(), robot.group().cause_pid), (Some(Cause::Disabled), 123));
    robot.follow_until(&joints, 3000, |robot| robot.phase() == Phase::Disarmed);
    assert_eq!(robot.operate(Operation::Enable).unwrap_err(), Refusal::Latched);
    robot.operate(Operation::Reset).unwrap();
    robot.follow(&joints);
    robot.operate(Operation::Enable).unwrap();
}

#[test]
fn returning_stiffness_pulls_from_present_position() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let mut joints = robot.activate();
    for _ in 0..300 {
        joints
            .iter_mut()
            .for_each(|joint| (joint.kp, joint.kd, joint.torque, joint.position) = (0.0, 0.2, 1.0, 0.0));
        robot.follow(&joints);
    }
    robot.take_sent();
    let stiff = robot.hold(40.0, 1.0);
    assert!(stiff[0].position > 0.2, "it was turned away from zero: {}", stiff[0].position);
    robot.follow(&stiff);
    for sent in robot.take_sent().iter().filter(|sent| sent.id == 1) {
        if let Meaning::Control { position, kp, .. } = sent.meaning {
            assert!(
                kp == 0.0 || (position - f64::from(stiff[0].position)).abs() < 0.05,
                "pulled to {position}"
            );
        }
    }
}

/// Goal: a held joint is damped before it goes limp, even when it was at rest all the time.
/// Method: the owner of a robot at rest becomes silent. The holding ends by its time, by an
/// emergency stop soon after its begin, or by one just before its end.
#[test]
fn held_stop_is_damped_before_limp() {
    for (held_for, emergency) in [(2000, false), (200, true), (1950, true)] {
        let mut settings = robot::three_motors();
        settings.groups[0].safe_stop = motord_settings::settings::SafeStop::Hold;
        let mut robot = Robot::new(settings, 1);
        robot.activate();
        robot.steps(20 + held_for);
        if emergency {
            robot.operate(Operation::EmergencyStop).unwrap();
        }
        robot.steps(5000);
        assert_eq!(robot.phase(), Phase::Disarmed);
        let received = robot.take_sent_to(1);
        let stiff = |sent: &robot::Sent| matches!(sent.meaning, Meaning::Control { kp, .. } if kp > 0.0);
        let released = received.iter().rposition(stiff).expect("it was held") + 1;
        assert!(held_for.abs_diff(released) < 100, "held for {released} of {held_for} cycles");
        let damped = received[released..].iter().take_while(|sent| sent.meaning != Meaning::Stop);
        let damping = |sent: &robot::Sent| matches!(sent.meaning, Meaning::Control { kd, .. } if kd > 0.0);
        assert!(damped.filter(|sent| damping(sent)).count() >= 50, "held for {held_for}, then limp");
    }
}

#[test]
fn lost_running_motor_is_unstopped_until_stop_answered() {
    let unstopped = |robot: &Robot| robot.cycle.unstopped().collect::<Vec<_>>();
    let mut robot = Robot::new(robot::three_motors(), 1);
    assert_eq!(unstopped(&robot), [0usize; 0], "none was started");
    let joints = robot.activate();
    assert_eq!(unstopped(&robot), [0, 1, 2]);
    robot.disturb("knee off");
    robot.follow_until(&joints, 100, |robot| robot.phase() == Phase::Disarmed);
    robot.steps(3000);
    assert_eq!((robot.phase(), unstopped(&robot)), (Phase::Disarmed, vec![2]));
    robot.disturb("knee ok");
    robot.steps(500);
    assert_eq!(unstopped(&robot), [0usize; 0]);
}

#[test]
fn an_emergency_is_never_held() {
    let mut settings = robot::three_motors();
    settings.groups[0].safe_stop = motord_settings::settings::SafeStop::Hold;
    let mut robot = Robot::new(settings, 1);
    robot.activate();
    robot.operate(Operation::EmergencyStop).unwrap();
    robot.take_sent();
    robot.steps(100);
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()));
}

#[test]
fn dropped_start_command_is_sent_again() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(10);
    robot.claim().unwrap();
    let joints = robot.hold(40.0, 1.0);
    robot.follow(&joints);
    robot.operate(Operation::Enable).unwrap();
    for _ in 0..8 {
        robot.follow(&joints);
    }
    robot.disturb("can tx-full");
    for _ in 0..2 {
        robot.follow(&joints);
    }
    robot.disturb("can ok");
    for _ in 0..100 {
        robot.follow(&joints);
    }
    assert_eq!(robot.phase(), Phase::Active);
    let sent = robot.take_sent();
    for id in 1..=3 {
        assert!(sent.iter().any(|sent| sent.id == id && sent.meaning == Meaning::Start), "motor {id}");
    }
}

#[test]
fn lost_motor_is_stopped_in_next_cycle() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let joints = robot.activate();
    robot.disturb("thigh off");
    while robot.mode(1) != MotorMode::Offline {
        robot.follow(&joints);
    }
    robot.take_sent();
    robot.step();
    let sent = robot.take_sent();
    assert!(
        sent.iter().any(|sent| sent.id == 2 && sent.meaning == Meaning::Stop),
        "it may hear and not be heard"
    );
}

#[test]
#[should_panic(expected = "\"knee\" is in no group")]
fn cycle_refuses_motor_without_group() {
    let mut settings = robot::three_motors();
    settings.groups[0].motors.pop();
    let _never = Robot::new(settings, 1);
}

#[test]
#[should_panic(expected = "\"hip\" is in more than one group")]
fn cycle_refuses_motor_in_two_groups() {
    let mut settings = robot::three_motors();
    settings.groups.push(settings.groups[0].clone());
    let _never = Robot::new(settings, 1);
}
