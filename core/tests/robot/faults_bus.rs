//! The fault catalogue, part A: faults of motors and buses, with simulated buses on virtual time.
//! `docs/faults.md` lists the item of each test.

use super::reply_with;
use motord_bus::{Duration, Instant};
use motord_core::control::Event;
use motord_core::drive::{Drive, Received};
use motord_harness::robot;
use motord_harness::robot::random::Random;
use motord_harness::robot::{Meaning, PERIOD, Robot, Sent};
use motord_protocol::drive::{Command, Reported};
use motord_settings::settings::{BeyondRange, Settings};
use motord_shared::{BusCondition, Cause, JointSetpoint, MotorMode, Operation, Phase, Refusal, message};
use motord_simulator::MotorSettings;

/// Returns an active robot of three motors, and the setpoints of its owner.
pub(crate) fn active() -> (Robot, Vec<JointSetpoint>) {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let joints = robot.activate();
    (robot, joints)
}

/// Runs cycles until the group is stopped, and returns their number. From the next cycle on, no
/// command moves a motor.
pub(crate) fn stopped_within(robot: &mut Robot, joints: &[JointSetpoint], cycles: usize) -> (Cause, usize) {
    for cycle in 1..=cycles {
        robot.follow(joints);
        if let Some(cause) = robot.cause() {
            robot.take_sent();
            robot.follow(joints);
            assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()), "damped in the next cycle");
            assert_ne!(robot.phase(), Phase::Active);
            return (cause, cycle);
        }
    }
    panic!("not stopped within {cycles} cycles");
}

fn is_fresh(robot: &mut Robot, joint: usize) -> bool {
    robot.joint(joint).flags & message::JOINT_FRESH != 0
}

#[test]
fn controller_overrun_counts_as_lost_frame() {
    let (mut robot, joints) = active();
    let before = robot.bus(0);
    robot.disturb("can overrun");
    robot.follow(&joints);
    let after = robot.bus(0);
    assert_eq!((after.lost - before.lost, after.errors - before.errors), (1, 1));
    assert_eq!((robot.cause(), after.condition), (None, before.condition));
}

/// Goal: where the adapter loses replies, the stop names the lost frames, not the power and the
/// cable of the motor.
#[test]
fn motor_lost_amid_lost_frames_names_them() {
    for (fault, kind) in [("can overrun", "the controller"), ("can overflow 3", "the kernel")] {
        let (mut robot, joints) = active();
        robot.disturb("thigh off");
        robot.disturb(fault);
        let (cause, _) = stopped_within(&mut robot, &joints, 12);
        assert_eq!((cause, robot.group().cause_joint), (Cause::FramesLost, 1), "{kind}");
    }
    let (mut robot, joints) = active();
    robot.disturb("can overrun");
    (0..1100).for_each(|_| robot.follow(&joints));
    robot.disturb("thigh off");
    let (cause, _) = stopped_within(&mut robot, &joints, 12);
    assert_eq!(cause, Cause::MotorLost, "frames that were lost more than a second before explain nothing");
}

#[test]
fn lost_frames_are_reported_once_a_second() {
    let (mut robot, joints) = active();
    let mut reported = Vec::new();
    for cycle in 0..2500 {
        if cycle % 9 == 0 {
            robot.disturb("can overrun");
        }
        robot.follow(&joints);
        reported.extend(robot.take_events().into_iter().filter_map(|event| match event {
            Event::FramesLost { bus, losses } => Some((bus, losses.by_controller)),
            _ => None,
        }));
    }
    assert_eq!(reported, [(0, 1), (0, 111), (0, 111)]);
}

/// Goal: the end of a burst is not reported with a loss of minutes later.
#[test]
fn last_losses_of_burst_are_reported_soon() {
    let (mut robot, joints) = active();
    let mut reported = Vec::new();
    for cycle in 0..1200 {
        if cycle < 3 {
            robot.disturb("can overrun");
        }
        robot.follow(&joints);
        reported.extend(robot.take_events().into_iter().filter_map(|event| match event {
            Event::FramesLost { losses, .. } => Some((cycle / 100, losses.by_controller)),
            _ => None,
        }));
    }
    assert_eq!(reported, [(0, 1), (10, 2)]);
}

#[test]
fn one_missed_reply_only_makes_state_stale() {
    let (mut robot, joints) = active();
    let missed = robot.joint(1).missed;
    robot.disturb("thigh off");
    robot.follow(&joints);
    assert!(!is_fresh(&mut robot, 1) && is_fresh(&mut robot, 0) && is_fresh(&mut robot, 2));
    assert_eq!((robot.joint(1).age_cycles, robot.joint(1).missed - missed), (1, 1));
    robot.disturb("thigh ok");
    robot.follow(&joints);
    assert!(is_fresh(&mut robot, 1));
    assert_eq!((robot.phase(), robot.mode(1)), (Phase::Active, MotorMode::Active));
}

#[test]
fn lost_motor_gets_ten_stops_a_second() {
    let (mut robot, joints) = active();
    robot.disturb("thigh off");
    for missed in 1..=3 {
        robot.follow(&joints);
        assert_eq!((robot.joint(1).age_cycles, robot.phase()), (missed, Phase::Active));
        assert!(!is_fresh(&mut robot, 1), "a silent motor's state is never fresh");
    }
    let (cause, _) = stopped_within(&mut robot, &joints, 8);
    assert_eq!(cause, Cause::MotorLost);
    robot.take_sent();
    robot.steps(1000);
    let received = robot.take_sent();
    let thigh: Vec<_> = received.iter().filter(|sent| sent.id == 2).map(|sent| sent.meaning).collect();
    assert!(thigh.len() <= 10 && thigh.contains(&Meaning::Stop), "{thigh:?}");
    assert!(thigh.iter().all(|meaning| matches!(meaning, Meaning::Stop | Meaning::GetFault)));
    assert!(received.iter().all(|sent| sent.meaning.is_safe()));
}

#[test]
fn a_late_reply_is_counted_late_and_once() {
    let (mut robot, joints) = active();
    robot.disturb("hip delayed 850us");
    robot.follow(&joints);
    robot.disturb("hip ok");
    robot.follow(&joints);
    let hip = robot.joint(0);
    assert_eq!((hip.late, hip.age_cycles, hip.missed), (1, 0, 1));
    assert!(hip.reply_latency_ns < 800_000, "the timely reply is measured, not the late one");
    assert_eq!((robot.bus(0).duplicate, robot.phase()), (0, Phase::Active));
}

#[test]
fn duplicate_reply_is_counted_and_ignored() {
    let (mut robot, joints) = active();
    robot.disturb("hip duplicate");
    robot.follow(&joints);
    robot.disturb("hip ok");
    robot.follow(&joints);
    assert_eq!((robot.bus(0).duplicate, robot.phase(), robot.joint(0).missed), (1, Phase::Active, 0));
}

#[test]
fn unexpected_ids_are_counted_and_change_nothing() {
    let (mut robot, joints) = active();
    robot.take_events();
    let before = robot.bus(0).unexpected_id;
    for cycle in 0..1000_u16 {
        robot.deliver_frame(0, cycle % 0x800, &[9, 0x80, 0, 0x80, 8, 0]);
        robot.deliver_frame(0, 0x101, &[77, 0x80, 0, 0x80, 8, 0]);
        robot.follow(&joints);
    }
    assert_eq!(robot.bus(0).unexpected_id - before, 2000);
    assert_eq!((robot.phase(), robot.take_events()), (Phase::Active, vec![]), "the log contains no event");
}

/// Returns a robot with a second motor with the thigh's ids, at another position.
fn with_a_double() -> Robot {
    Robot::built(robot::three_motors(), 1, |_, motors| {
        let double = MotorSettings { name: "double".into(), initial_position: 1.0, ..motors[1].clone() };
        motors.push(MotorSettings { reply_latency: Duration::from_micros(80), ..double });
    })
}

#[test]
fn two_motors_with_one_id_are_never_started() {
    let mut robot = with_a_double();
    robot.steps(100);
    robot.claim().unwrap();
    let joints = robot.hold(0.0, 1.0);
    for _ in 0..100 {
        robot.follow(&joints);
    }
    let refusal = robot.operate(Operation::Enable).unwrap_err();
    assert!(matches!(refusal, Refusal::DuplicateId | Refusal::StateStale), "{refusal}");
}

#[test]
fn duplicate_motor_id_stops_group_within_ten_cycles() {
    let mut robot = with_a_double();
    robot.disturb("double off");
    let joints = robot.activate();
    robot.disturb("double ok");
    let (cause, cycles) = stopped_within(&mut robot, &joints, 10);
    assert!(matches!(cause, Cause::DuplicateId | Cause::Implausible), "{cause}");
    assert!(cycles <= 10);
}

#[test]
fn implausible_state_is_not_counted_as_malformed() {
    let mut robot = with_a_double();
    robot.disturb("double off");
    let joints = robot.activate();
    let (counted, malformed) = (robot.joint(1).implausible, robot.bus(0).malformed);
    robot.disturb("thigh off");
    robot.disturb("double ok");
    robot.follow(&joints);
    assert_eq!((robot.joint(1).implausible, robot.bus(0).malformed), (counted + 1, malformed));
}

#[test]
fn frames_of_no_motor_are_counted_not_decoded() {
    let (mut robot, joints) = active();
    let malformed = robot.bus(0).malformed;
    for verb in ["extended", "remote", "fd"] {
        robot.disturb(&format!("can {verb}"));
    }
    robot.disturb("hip short");
    robot.follow(&joints);
    robot.disturb("hip ok");
    assert_eq!(robot.bus(0).malformed - malformed, 4);
    assert!(!is_fresh(&mut robot, 0), "a short reply is none");
    robot.follow(&joints);
    assert_eq!(robot.phase(), Phase::Active);
}

/// Returns the hip's drive with a request sent at 1 s, and the time at which an answer arrives.
fn asked_drive(settings: &Settings, command: &Command) -> (Drive, Instant) {
    let mut drive = Drive::new(&settings.motors[0], Duration::ZERO, false);
    let now = Instant::from_nanos(1_000_000_000);
    drive.request(command, now).expect("it is a frame");
    (drive, now + Duration::from_micros(300))
}

#[test]
fn six_bytes_are_a_reply_and_fewer_none() {
    let reply = [1, 0x80, 0, 0x80, 8, 0, 0, 0];
    for length in 0..=8 {
        let (mut drive, later) = asked_drive(&robot::three_motors(), &Command::Stop);
        let received = matches!(
            drive.receive(&reply_with(&reply[..length]), later),
            Received::Reply(Reported::State(..))
        );
        assert_eq!(received, length >= 6, "{length} bytes");
    }
}

#[test]
fn no_bytes_decode_to_a_nonfinite_state() {
    let (mut random, settings) = (Random::new(9), robot::three_motors());
    for _ in 0..1_000_000 {
        let (mut drive, later) = asked_drive(&settings, random.pick(&[Command::Stop, Command::GetFault]));
        let bytes = random.draw().to_be_bytes();
        if let Received::Reply(Reported::State(state, ..)) =
            drive.receive(&reply_with(&bytes[..random.below(9)]), later)
        {
            assert!([state.position, state.velocity, state.torque].iter().all(|value| value.is_finite()));
        }
    }
}

#[test]
fn garbage_is_never_believed_and_stops_when_sustained() {
    let (mut robot, joints) = active();
    let before = robot.joint(2).position;
    robot.disturb("knee garbage");
    let (cause, cycles) = stopped_within(&mut robot, &joints, 12);
    assert!(matches!(cause, Cause::Implausible | Cause::MotorLost), "{cause}");
    assert!(cycles >= 3, "one or two odd replies are noise");
    robot.disturb("knee ok");
    robot.steps(100);
    assert!((robot.joint(2).position - before).abs() < 0.1, "the truth is believed again");
}

#[test]
fn frozen_encoder_of_moving_joint_stops_group() {
    let (mut robot, mut joints) = active();
    joints.iter_mut().for_each(|joint| (joint.kp, joint.kd, joint.velocity) = (0.0, 2.0, 3.0));
    for _ in 0..100 {
        robot.follow(&joints);
    }
    robot.disturb("thigh stuck");
    let (cause, cycles) = stopped_within(&mut robot, &joints, 60);
    assert_eq!(cause, Cause::EncoderStuck);
    assert!(cycles >= 50);
}

#[test]
fn fault_is_known_although_replies_are_lost() {
    let (mut robot, joints) = active();
    robot.disturb("knee intermittent 60%");
    robot.disturb("knee fault 0x40");
    robot.follow_until(&joints, 50, |robot| robot.cause().is_some());
    for _ in 0..3000 {
        robot.follow(&joints);
        let knee = robot.joint(2);
        assert!(knee.position.is_nan() || knee.position.abs() < 0.05, "{knee:?}");
        assert!(knee.fault == 0 || knee.fault == 0x40, "{knee:?}");
    }
    assert_eq!((robot.phase(), robot.joint(2).fault), (Phase::Disarmed, 0x40));
}

#[test]
fn answer_to_old_fault_question_is_no_state() {
    let fault = [1, 0x40, 0, 0, 0, 0];
    let (mut drive, later) = asked_drive(&robot::three_motors(), &Command::GetFault);
    drive.request(&Command::Stop, later);
    // The last four bytes of a fault report have no meaning (MIT document 1.2), so they may have
    // any value.
    let answer = drive.receive(&reply_with(&[1, 0x40, 0x80, 8, 8, 0]), later + Duration::from_micros(300));
    assert_eq!(answer, Received::Reply(Reported::Late));
    let (mut first, later) = asked_drive(&robot::three_motors(), &Command::Stop);
    assert_eq!(
        first.receive(&reply_with(&fault), later),
        Received::Malformed,
        "not even as the first state of all"
    );
}

/// Goal: a dropped reply changes nothing, including the count of turns.
/// Method: a fault report, read as a position, lies just beyond half a turn from the state before,
/// and just within it from the state after. If it were counted, one turn too many would result.
#[test]
fn dropped_reply_keeps_the_turn_count() {
    let mut settings = robot::three_motors();
    settings.motors[0].beyond_range = BeyondRange::Wrap;
    let (mut drive, mut now) = asked_drive(&settings, &Command::Stop);
    let mut read = |command: &Command, reply: &[u8]| {
        drive.request(command, now - Duration::from_micros(200));
        let answer = drive.receive(&reply_with(reply), now);
        now = now + PERIOD;
        answer
    };
    // Positions: -0.6 rad, 11.91 rad, -0.5 rad.
    assert!(matches!(
        read(&Command::Stop, &[1, 0x79, 0xDB, 0x80, 8, 0]),
        Received::Reply(Reported::State(..))
    ));
    assert_eq!(read(&Command::GetFault, &[]), Received::Malformed);
    assert_eq!(read(&Command::Stop, &[1, 0xFA, 0, 0x80, 8, 0]), Received::Reply(Reported::Late));
    let Received::Reply(Reported::State(state, ..)) = read(&Command::Stop, &[1, 0x7A, 0xE1, 0x80, 8, 0])
    else {
        panic!("it is a state");
    };
    assert!((state.position + 0.5).abs() < 0.01, "{} rad", state.position);
}

#[test]
fn lost_fault_answer_costs_one_more_cycle() {
    let fault = [1, 0x40, 0, 0, 0, 0];
    let (mut drive, mut now) = asked_drive(&robot::three_motors(), &Command::GetFault);
    let mut received = Vec::new();
    for _ in 0..2 {
        now = now + PERIOD;
        drive.request(&Command::GetFault, now);
        received.push(drive.receive(&reply_with(&fault), now + Duration::from_micros(300)));
        now = now + PERIOD;
        drive.request(&Command::Stop, now);
    }
    assert_eq!(received[0], Received::Reply(Reported::Late));
    assert!(matches!(received[1], Received::Reply(Reported::Fault(_))), "{received:?}");
}

#[test]
fn fault_report_is_read_after_unanswered_questions() {
    let (mut drive, mut now) = asked_drive(&robot::three_motors(), &Command::Stop);
    // Garbage, which is a state of full speed backward.
    drive.receive(&reply_with(&[1, 0x80, 0, 0, 8, 0]), now);
    for _ in 0..4 {
        now = now + Duration::from_millis(100);
        drive.request(&Command::Stop, now);
    }
    now = now + Duration::from_millis(100);
    drive.request(&Command::GetFault, now);
    let answer = drive.receive(&reply_with(&[1, 0x40, 0, 0, 0, 0]), now + Duration::from_micros(300));
    assert!(matches!(answer, Received::Reply(Reported::Fault(_))), "{answer:?}");
}

#[test]
fn lagging_state_is_no_fault_but_report_is() {
    let state = [1, 0x80, 0, 0x80, 8, 0];
    let (mut drive, mut later) = asked_drive(&robot::three_motors(), &Command::Stop);
    let lagging = |drive: &mut Drive, later: Instant| {
        drive.request(&Command::Stop, later - Duration::from_micros(100));
        drive.receive(&reply_with(&state), later)
    };
    for _ in 0..10 {
        for _ in 0..100 {
            later = later + PERIOD;
            let answer = lagging(&mut drive, later);
            assert!(matches!(answer, Received::Reply(Reported::State(..))), "{answer:?}");
        }
        drive.request(&Command::GetFault, later + Duration::from_micros(100));
        let answer = drive.receive(&reply_with(&state), later + Duration::from_micros(200));
        assert_eq!(answer, Received::Reply(Reported::Late));
        later = later + PERIOD;
        drive.request(&Command::Stop, later - Duration::from_micros(200));
        let answer = drive.receive(&reply_with(&[1, 0x40, 0, 0, 0, 0]), later - Duration::from_micros(100));
        assert!(matches!(answer, Received::Reply(Reported::Fault(bits)) if bits.0 == 0x40), "{answer:?}");
    }
}

/// Goal: a motor that answers questions for its faults by states, as relatives without such a
/// command do, has no fault.
#[test]
fn state_as_fault_answer_is_no_fault() {
    let (mut drive, mut later) = asked_drive(&robot::three_motors(), &Command::Stop);
    for _ in 0..100 {
        for command in [Command::Stop, Command::GetFault] {
            drive.request(&command, later - Duration::from_micros(100));
            let answer = drive.receive(&reply_with(&[1, 0x80, 0, 0x80, 8, 0]), later);
            assert!(!matches!(answer, Received::Reply(Reported::Fault(_))), "{answer:?}");
            later = later + Duration::from_millis(100);
        }
    }
}

#[test]
fn error_frames_change_only_bus_knowledge() {
    let (mut robot, joints) = active();
    let before = robot.bus(0);
    robot.disturb("can warning");
    robot.follow(&joints);
    let now = robot.bus(0);
    assert_eq!(
        (now.errors - before.errors, now.malformed, now.unexpected_id),
        (1, before.malformed, before.unexpected_id)
    );
    assert_eq!((now.condition, robot.phase()), (BusCondition::Warning.code(), Phase::Active));
}

#[test]
fn bus_off_pauses_sending_and_resumes_with_stops() {
    let mut robot = Robot::new(robot::quadruped(), 1);
    let joints = robot.activate();
    robot.disturb("front-left bus-off");
    let (cause, cycles) = stopped_within(&mut robot, &joints, 3);
    assert_eq!((cause, robot.bus(0).condition), (Cause::BusOff, BusCondition::Off.code()));
    assert!(cycles <= 2);
    let sent = robot.bus(0).sent;
    robot.steps(500);
    assert_eq!(robot.bus(0).sent, sent, "nothing is sent to a bus that is off");
    robot.disturb("front-left ok");
    robot.take_sent();
    robot.steps(3000);
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()), "nothing starts by itself");
    assert_eq!((robot.bus(0).condition, robot.mode(0)), (BusCondition::Active.code(), MotorMode::Idle));
    robot.operate(Operation::Reset).unwrap();
    robot.activate();
}

#[test]
fn only_bus_of_robot_is_read_after_return() {
    let (mut robot, _) = active();
    robot.disturb("can bus-off");
    robot.steps(500);
    assert_eq!(robot.bus(0).condition, BusCondition::Off.code());
    robot.disturb("can ok");
    robot.steps(500);
    assert_eq!(robot.bus(0).condition, BusCondition::Active.code());
    assert!((0..3).all(|joint| robot.mode(joint) == MotorMode::Idle));
}

#[test]
fn a_flapping_controller_warns_and_stops_nothing() {
    let (mut robot, joints) = active();
    for cycle in 0..1000 {
        robot.disturb(if cycle % 10 < 5 { "can passive" } else { "can active" });
        robot.follow(&joints);
    }
    assert_eq!((robot.phase(), robot.bus(0).errors), (Phase::Active, 1000));
}

#[test]
fn full_queue_three_times_in_row_stops_group() {
    let (mut robot, joints) = active();
    let before = robot.bus(0);
    robot.disturb("can tx-full 1");
    robot.follow(&joints);
    robot.disturb("can ok");
    let now = robot.bus(0);
    assert_eq!((now.sent - before.sent, now.dropped - before.dropped), (1, 2), "no frame is tried again");
    assert_eq!(robot.take_sent().len(), 1);
    robot.follow(&joints);
    assert_eq!((robot.phase(), robot.take_sent().len()), (Phase::Active, 3));

    robot.disturb("can tx-full 1");
    let (cause, cycles) = stopped_within(&mut robot, &joints, 4);
    assert_eq!((cause, cycles), (Cause::TransmitStall, 4), "told in the cycle after the third");
}

/// Returns the frames of a robot whose bus refused them for 500 cycles, in the 100 after that.
fn sent_after(disturbance: &str) -> Vec<Sent> {
    let (mut robot, joints) = active();
    robot.disturb(disturbance);
    for _ in 0..500 {
        robot.follow(&joints);
    }
    robot.disturb("can ok");
    robot.take_sent();
    for _ in 0..100 {
        robot.follow(&joints);
    }
    robot.take_sent()
}

#[test]
fn what_was_refused_is_never_sent_later() {
    assert!(sent_after("can tx-full").iter().all(|sent| sent.meaning.is_safe()));
}

#[test]
fn frames_of_jammed_bus_are_discarded() {
    assert!(sent_after("can no-ack").iter().all(|sent| sent.meaning.is_safe()));
}

#[test]
fn lost_interface_stops_group_and_returns_stopped() {
    for (verb, condition) in [("down", BusCondition::Down), ("gone", BusCondition::Gone)] {
        let (mut robot, joints) = active();
        robot.disturb(&format!("can {verb}"));
        let (cause, cycles) = stopped_within(&mut robot, &joints, 3);
        assert_eq!((cause, robot.bus(0).condition), (Cause::BusGone, condition.code()));
        assert!(cycles <= 2);
        robot.steps(2500);
        assert_eq!(robot.operate(Operation::Reset).unwrap_err(), Refusal::BusDown);
        robot.disturb("can ok");
        robot.reopen(0);
        robot.take_sent();
        robot.steps(500);
        assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()));
        robot.operate(Operation::Reset).unwrap();
        robot.activate();
    }
}

#[test]
fn flood_neither_delays_cycle_nor_hides_replies() {
    let mut text = String::from("[cycle]\nrate-hz = 250\n[[bus]]\nname = \"can\"\ntype = \"simulated\"\n");
    for (id, name) in [(1, "hip"), (2, "thigh"), (3, "knee")] {
        text += &robot::motor(id, name, "can", "");
    }
    let mut robot = Robot::new(robot::settings(&text), 1);
    let joints = robot.activate();
    let before: Vec<_> = (0..3).map(|joint| robot.joint(joint).missed).collect();
    robot.disturb("can flood 8000");
    for _ in 0..1000 {
        robot.follow(&joints);
    }
    assert!(robot.bus(0).unexpected_id > 20_000, "the wire is full");
    assert_eq!((robot.phase(), robot.state().overruns), (Phase::Active, 0));
    assert_eq!((0..3).map(|joint| robot.joint(joint).missed).collect::<Vec<_>>(), before);
}

#[test]
fn frames_lost_before_they_were_read_are_counted() {
    let (mut robot, joints) = active();
    robot.disturb("can overflow 5");
    robot.follow(&joints);
    assert_eq!((robot.bus(0).lost, robot.phase()), (5, Phase::Active));
}
