//! Motors with MyActuator's protocol in the cycle, beside MIT motors on one bus, on virtual time. They
//! need no enable.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use super::family;
use motord_bus::{Duration, FrameId, Instant};
use motord_core::drive::safe_frames;
use motord_harness::robot::random::Random;
use motord_harness::robot::{self, Meaning, Robot};
use motord_protocol::Faults;
use motord_settings::plan::BusPlan;
use motord_shared::{Cause, JointSetpoint, MotorMode, Operation, Phase};
use motord_simulator::Mode;

/// Index of the MyActuator motor, and its id.
const KNEE: usize = 1;
const ID: u16 = 5;
/// Frames that an adapter keeps while no node acknowledges.
const ADAPTER: usize = 64;

const HEAD: &str = "[cycle]\nrate-hz = 1000\n[safety]\nsetpoint-timeout-ms = 20\n[[bus]]\nname = \"can\"\n\
                    type = \"simulated\"\n";

fn rmd(id: u8, name: &str) -> String {
    family::motor(family::MYACTUATOR, id, name, "")
}

fn text() -> String {
    family::leg(family::MYACTUATOR)
}

fn leg() -> Robot {
    Robot::new(robot::settings(&text()), 3)
}

/// Three motors without an enable, alone on a bus whose adapter keeps frames.
fn powerless(seed: u64) -> Robot {
    let text = HEAD.to_owned() + &rmd(1, "hip") + &rmd(2, "thigh") + &rmd(32, "knee");
    Robot::built(robot::settings(&text), seed, |bus, motors| {
        bus.adapter = Some(ADAPTER);
        motors.iter_mut().for_each(|motor| motor.boot_time = Duration::from_millis(60));
    })
}

fn deliver(robot: &mut Robot, id: u16, payload: &[u8]) {
    robot.deliver_with_id(0, FrameId::new(id).unwrap(), payload);
}

/// Moves every joint in the cycle with this number.
fn wave(rest: &[JointSetpoint], cycle: usize) -> Vec<JointSetpoint> {
    let phase = cycle as f32 / 1000.0 * core::f32::consts::TAU;
    let joint = |still: &JointSetpoint| JointSetpoint {
        position: still.position + 0.2 * (1.0 - phase.cos()),
        kp: 60.0,
        ..*still
    };
    rest.iter().map(joint).collect()
}

fn follow_wave(robot: &mut Robot, rest: &[JointSetpoint], cycles: usize) {
    (0..cycles).for_each(|cycle| robot.follow(&wave(rest, cycle)));
}

#[test]
fn motor_follows_beside_mit_motor() {
    let mut robot = leg();
    let rest = robot.activate();
    for cycle in 0..2000 {
        let wanted = wave(&rest, cycle);
        robot.follow(&wanted);
        assert_eq!(robot.phase(), Phase::Active, "stopped after {cycle} cycles: {:?}", robot.cause());
        let error = (robot.joint(KNEE).position - wanted[KNEE].position).abs();
        assert!(error < 0.06, "{error} rad after {cycle} cycles");
    }
    let truth = robot.truth(KNEE).position();
    let (joint, bus) = (robot.joint(KNEE), robot.bus(0));
    assert!((f64::from(joint.position) - (0.2 - truth)).abs() < 0.01, "direction and offset");
    assert!((joint.temperature - 25.0).abs() < 2.0, "{}", joint.temperature);
    assert_eq!((joint.fault, joint.missed, joint.late), (0, 0, 0));
    assert_eq!((bus.malformed, bus.duplicate, bus.unexpected_id), (0, 0, 0));
}

#[test]
fn stopped_motor_reports_position_and_is_not_moved() {
    let mut robot = leg();
    robot.steps(500);
    let (joint, truth) = (robot.joint(KNEE), robot.truth(KNEE).position());
    assert_eq!((robot.mode(KNEE), robot.truth(KNEE).mode()), (MotorMode::Idle, Mode::Stopped));
    assert!((f64::from(joint.position) - (0.2 - truth)).abs() < 1e-3, "{} {truth}", joint.position);
    assert!(joint.missed == 0 && joint.age_cycles <= 1, "{joint:?}");
    let sent = robot.take_sent_to(ID);
    assert!(sent.iter().all(|sent| sent.frame.id().raw() == 0x145), "no impedance");
    assert!(robot.truth(KNEE).last_executed().is_none());
}

/// The first impedance runs the motor, so the question for its status comes first.
#[test]
fn start_asks_status_then_sends_neutral() {
    let mut robot = leg();
    robot.steps(100);
    robot.take_sent();
    family::enable(&mut robot);
    let sent = robot.take_sent_to(ID);
    let first = sent.iter().position(|sent| sent.frame.id().raw() == 0x405).unwrap();
    assert_eq!(sent[first - 1].bytes, [0x9A, 0, 0, 0, 0, 0, 0, 0]);
    assert!(sent[first].meaning.is_safe(), "{:?}", sent[first]);
    assert_eq!(robot.truth(KNEE).mode(), Mode::Running);
}

#[test]
fn motor_with_error_gets_no_impedance() {
    let mut robot = leg();
    robot.steps(100);
    robot.disturb("knee fault 0x04");
    robot.claim().unwrap();
    let joints = robot.hold(40.0, 1.0);
    robot.follow(&joints);
    let _refused = robot.operate(Operation::Enable);
    (0..200).for_each(|_| robot.follow(&joints));
    assert_eq!((robot.mode(KNEE), robot.joint(KNEE).fault), (MotorMode::Fault, Faults::UNDER_VOLTAGE.0));
    assert!(robot.take_sent_to(ID).iter().all(|sent| sent.frame.id().raw() == 0x145));
}

#[test]
fn stop_damps_then_switches_off() {
    let mut robot = leg();
    let sent = family::check_stop(&mut robot, KNEE, ID);
    assert!(sent.iter().any(|sent| sent.meaning == Meaning::Stop));
}

/// The frames of the dead man's switch and of `safe-stop`. Damping of 2 N·m·s/rad is 1638 of 4095, 0x666.
#[test]
fn safe_frames_damp_and_switch_off() {
    let settings = robot::settings(&text());
    let (damp, stop) = safe_frames(&settings.motors[KNEE]).unwrap();
    for frame in damp {
        assert_eq!(frame.id(), FrameId::new(0x405).unwrap());
        let [_, _, _, kp, stiff, high, low, _] = *frame.payload() else { panic!("eight bytes") };
        assert_eq!((kp & 0x0F, stiff, high, low >> 4), (0, 0, 0x66, 0x6));
    }
    assert_ne!(damp[0], damp[1], "each pushes as the other pushes back");
    assert_eq!((stop.id(), stop.payload()), (FrameId::new(0x145).unwrap(), &[0x80, 0, 0, 0, 0, 0, 0, 0][..]));
}

/// An impedance is answered without faults: the poll finds them, at 10 Hz.
#[test]
fn errors_stop_group_and_are_cleared() {
    for (number, fault) in [
        ("0x02", Faults::OVERLOAD),
        ("0x04", Faults::UNDER_VOLTAGE),
        ("0x100", Faults::of_unknown_code(8)),
        ("0x1000", Faults::MOTOR_OVER_TEMPERATURE),
        ("0x2000", Faults::ENCODER),
    ] {
        let mut robot = leg();
        let joints = robot.activate();
        robot.disturb(&format!("knee fault {number}"));
        robot.follow_until(&joints, 250, |robot| robot.cause().is_some());
        assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::MotorFault), KNEE as u32));
        family::check_clearing(&mut robot, KNEE, fault.0);
    }
}

/// Function 3 of command 0x20: status 1 each 100 ms while the motor has an error.
#[test]
fn unasked_status_with_error_stops_group() {
    let mut robot = leg();
    let joints = robot.activate();
    deliver(&mut robot, 0x245, &[0x9A, 25, 0, 1, 0xE0, 1, 0x08, 0]);
    robot.follow(&joints);
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::MotorFault), KNEE as u32));
    assert_eq!(robot.joint(KNEE).fault, Faults::OVER_VOLTAGE.0);
}

/// Status 1 without an error, and answers to another program, at each time of a cycle.
#[test]
fn unprompted_frames_change_nothing() {
    let [status, angle] = [[0x9A, 25, 0, 1, 0xE0, 1, 0, 0], [0x92, 0, 0, 0, 0x10, 0x27, 0, 0]];
    for payload in [status, angle, [0xB2, 0, 0, 0, 1, 2, 3, 4]] {
        let what = format!("{payload:?}");
        family::check_unprompted(&mut leg(), KNEE, &what, |robot| deliver(robot, 0x245, &payload));
    }
}

/// Goal: an angle on another scale than that of impedances pulls no joint. Method: the answers to the
/// first impedances are 1 rad off.
#[test]
fn other_position_after_start_is_implausible() {
    let mut robot = leg();
    robot.steps(100);
    robot.claim().unwrap();
    let joints = robot.hold(40.0, 1.0);
    robot.follow(&joints);
    robot.operate(Operation::Enable).unwrap();
    robot.follow_until(&joints, 50, |robot| robot.truth(KNEE).mode() == Mode::Running);
    robot.disturb("knee wrong");
    robot.follow_until(&joints, 20, |robot| robot.cause().is_some());
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::Implausible), KNEE as u32));
}

#[test]
fn two_motors_with_one_id_stop_group() {
    let mut robot = leg();
    let id = FrameId::new(0x505).unwrap();
    family::check_duplicate(&mut robot, KNEE, id, &[5, 0x7F, 0xFF, 0x7F, 0xF7, 0xFF, 0, 0]);
}

#[test]
fn commands_of_another_program_are_foreign() {
    let mut robot = leg();
    robot.steps(100);
    deliver(&mut robot, 0x145, &[0xA1, 0, 0, 0, 0, 0, 0, 0]);
    deliver(&mut robot, 0x405, &[0x7F, 0xFF, 0x7F, 0xF1, 0x48, 0x33, 0x37, 0xFF]);
    robot.steps(10);
    assert_eq!([0, KNEE].map(|joint| robot.joint(joint).foreign_commands), [0, 2]);
}

/// Goal: no bytes with the ids of a motor move the joint or raise a fault. Method: each first byte and
/// length but states and statuses, which the motor may send.
#[test]
fn hostile_frames_move_nothing() {
    let mut robot = leg();
    let joints = robot.activate();
    for first in (0..=255_u8).filter(|first| *first != 0x9A) {
        for length in [0, 1, 7, 8] {
            let is_state = length == 8 && u16::from(first) == ID;
            for id in [0x245, 0x505].into_iter().filter(|id| *id == 0x245 || !is_state) {
                deliver(&mut robot, id, &[first; 8][..length]);
                (0..5).for_each(|_| robot.follow(&joints));
            }
        }
    }
    family::check_unmoved(&mut robot, KNEE, &joints);
}

#[test]
fn lost_motor_returns_after_power_cycle() {
    let mut robot = leg();
    family::check_power_cycle(&mut robot, KNEE);
}

/// The zero is stored, and acts after the restart that follows it.
#[test]
fn zero_is_set_by_a_restart() {
    let mut robot = leg();
    robot.steps(500);
    robot.operate_joint(Operation::SetZero, KNEE).unwrap();
    robot.steps(1000);
    assert!((robot.joint(KNEE).position - 0.2).abs() < 0.01, "{}", robot.joint(KNEE).position);
    let sent = robot.take_sent_to(ID);
    let resets = sent.iter().filter(|sent| sent.bytes[0] == 0x76).count();
    assert_eq!((resets, sent.iter().filter(|sent| sent.meaning == Meaning::SetZero).count()), (1, 1));
    assert_eq!(robot.mode(KNEE), MotorMode::Idle);
    robot.activate();
}

/// Cuts the power of the bus in the middle of a cycle.
fn cut(robot: &mut Robot, after: Duration) -> Instant {
    let at = robot.now() + after;
    robot.buses[0].inject(at, &"can power-off".parse().unwrap()).unwrap();
    at
}

/// Goal: after a power cut no motor without an enable executes a frame from before it, and none gets an
/// impedance before it has answered a question. Method: 1000 cuts at random instants of a motion, each
/// for 1 to 300 ms.
#[test]
fn no_old_impedance_is_executed_after_return() {
    let mut random = Random::new(59);
    for seed in 0..1000 {
        let mut robot = powerless(seed);
        let rest = robot.activate();
        follow_wave(&mut robot, &rest, 5 + random.below(50));
        let at = cut(&mut robot, Duration::from_nanos(random.below(1_200_000) as u64));
        let dark = *random.pick(&[1, 8, 15, 60, 300]);
        follow_wave(&mut robot, &rest, dark);
        robot.take_sent();
        robot.disturb("can ok");
        robot.steps(800);
        let sent = robot.take_sent();
        let is_question = |id: u32| (0x141..=0x160).contains(&id);
        assert!(sent.iter().all(|sent| is_question(sent.frame.id().raw())), "seed {seed}, {dark} ms");
        for joint in 0..3 {
            let (executed, _) = robot.truth(joint).last_executed().expect("it moved");
            assert!(executed <= at, "seed {seed}, {dark} ms: joint {joint} was moved");
            assert_eq!(robot.truth(joint).mode(), Mode::Stopped);
        }
        assert!((0..3).all(|joint| robot.mode(joint) == MotorMode::Idle), "seed {seed}, {dark} ms");
        assert_eq!(robot.phase(), Phase::Disarmed);
    }
}

#[test]
fn motors_rest_at_return_and_start_again() {
    let mut robot = powerless(1);
    let rest = robot.activate();
    follow_wave(&mut robot, &rest, 100);
    cut(&mut robot, Duration::from_micros(300));
    follow_wave(&mut robot, &rest, 3000);
    assert_eq!(robot.cause(), Some(Cause::PowerLost));
    family::check_rest::<3>(&mut robot);
    robot.operate(Operation::Reset).unwrap();
    robot.activate();
}

/// A frame of 8 bytes has at most 135 bits; a reply of SteadyWin's motor 115.
#[test]
fn bus_plan_has_frames_of_eight_bytes() {
    let plan = &BusPlan::of(&robot::settings(&text()))[0];
    let expected = f64::from(3 * 135 + 115) / 1000.0;
    assert!((plan.worst_case_utilisation - expected).abs() < 0.001, "{}", plan.worst_case_utilisation);
}

/// A joint without stiffness that turns on beyond the end of the codes, which the motor wraps.
#[test]
fn position_is_unwrapped() {
    family::check_unwrapping(&text(), KNEE);
}
