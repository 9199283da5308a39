//! Motors with CANSimple drivers in the cycle, beside MIT motors on one bus, on virtual time.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use super::family;
use motord_bus::FrameId;
use motord_core::drive::safe_frames;
use motord_harness::robot::{self, Meaning, Robot};
use motord_protocol::Faults;
use motord_settings::plan::BusPlan;
use motord_shared::{Cause, MotorMode, Operation};

/// Index of the motor with a CANSimple driver.
const KNEE: usize = 1;
/// Its node, and the first of its ids.
const NODE: u8 = 5;
const BASE: u16 = 0x0A0;

fn text() -> String {
    family::leg(family::CANSIMPLE)
}

/// The first estimates of the node have arrived.
fn leg() -> Robot {
    let mut robot = Robot::new(robot::settings(&text()), 3);
    robot.steps(50);
    robot
}

fn deliver(robot: &mut Robot, command: u16, payload: &[u8]) {
    robot.deliver_with_id(0, FrameId::new(BASE | command).unwrap(), payload);
}

#[test]
fn node_follows_beside_mit_motor() {
    let mut robot = leg();
    family::check_wave(&mut robot, KNEE, 0.06);
    let truth = robot.truth(KNEE).position();
    assert!((f64::from(robot.joint(KNEE).position) - (0.2 - truth)).abs() < 0.02, "direction and offset");
    let (joint, bus) = (robot.joint(KNEE), robot.bus(0));
    assert_eq!((joint.fault, joint.missed, joint.late), (0, 0, 0));
    assert_eq!((bus.malformed, bus.duplicate, bus.unexpected_id), (0, 0, 0));
}

/// The estimates of a stopped motor are those of the rotor.
#[test]
fn stopped_node_reports_position_at_output() {
    let mut robot = leg();
    robot.steps(500);
    let truth = robot.truth(KNEE).position();
    let joint = robot.joint(KNEE);
    assert_eq!(robot.mode(KNEE), MotorMode::Idle);
    assert!((f64::from(joint.position) - (0.2 - truth)).abs() < 1e-3, "{} {truth}", joint.position);
    assert!(joint.missed == 0 && joint.age_cycles <= 11, "{joint:?}");
    let sent = robot.take_sent_to(NODE.into());
    assert!(sent.iter().all(|sent| sent.frame.id().raw() & 0x1F != 0x09), "the id of the estimates");
}

/// Mode, neutral impedance, closed loop; no impedance before a heartbeat reports it.
#[test]
fn node_is_enabled_after_mode_and_neutral() {
    let mut robot = leg();
    robot.steps(500);
    robot.take_sent();
    family::enable(&mut robot);
    let sent = robot.take_sent_to(NODE.into());
    let commands = sent.iter().map(|sent| (sent.frame.id().raw() & 0x1F, sent.bytes[0]));
    let begin = commands.skip_while(|(command, _)| *command == 0x03);
    let begin: Vec<_> =
        begin.map(|(command, first)| if command == 8 { (8, 0) } else { (command, first) }).collect();
    let first = [(0x0B, 3), (0x03, 0), (0x08, 0), (0x03, 0), (0x07, 8), (0x03, 0)];
    assert_eq!(begin[..6], first, "{begin:X?}");
    assert_eq!(robot.truth(KNEE).mode(), motord_simulator::Mode::Running);
    assert_eq!(begin.iter().filter(|(command, _)| *command == 0x07).count(), 1);
}

#[test]
fn stop_damps_then_disables_node() {
    let mut robot = leg();
    let sent = family::check_stop(&mut robot, KNEE, NODE.into());
    assert!(sent.iter().any(|sent| sent.meaning == Meaning::Stop));
    robot.steps(1000);
    let sent = robot.take_sent_to(NODE.into());
    assert!(sent.iter().all(|sent| sent.meaning != Meaning::Stop), "it has reported that it is idle");
}

/// The frames of the dead man's switch and of `safe-stop`.
#[test]
fn safe_frames_damp_and_disable_node() {
    let settings = robot::settings(&text());
    let (damp, stop) = safe_frames(&settings.motors[KNEE]).unwrap();
    // Damping of 2 N·m·s/rad is 1638 of 4095, 0x666, beside the codes next to zero.
    for frame in damp {
        assert_eq!(frame.id(), FrameId::new(BASE | 0x08).unwrap());
        let [_, _, _, _, _, high, low, _] = *frame.payload() else { panic!("eight bytes") };
        assert_eq!((high, low >> 4), (0x66, 0x6));
    }
    assert_ne!(damp[0], damp[1], "each pushes as the other pushes back");
    let idle = [1, 0, 0, 0, 0, 0, 0, 0];
    assert_eq!((stop.id(), stop.payload()), (FrameId::new(BASE | 0x07).unwrap(), &idle[..]));
}

#[test]
fn errors_stop_group_and_are_cleared() {
    for (number, fault) in [
        ("0x04", Faults::UNDER_VOLTAGE),
        ("0x08", Faults::MOTOR_OVER_TEMPERATURE),
        ("0x40", Faults::OVER_CURRENT),
    ] {
        let mut robot = leg();
        let joints = robot.activate();
        robot.disturb(&format!("knee fault {number}"));
        robot.follow_until(&joints, 150, |robot| robot.cause().is_some());
        assert_eq!(robot.group().cause_joint, KNEE as u32, "{number}: {:?}", robot.cause());
        family::check_clearing(&mut robot, KNEE, fault.0);
    }
}

/// Its heartbeats say so, before its silence would.
#[test]
fn node_that_disables_itself_is_motor_off() {
    let mut robot = leg();
    let joints = robot.activate();
    for _ in 0..20 {
        deliver(&mut robot, 0x01, &[0, 0, 0, 0, 1, 0, 0, 0]);
        robot.follow(&joints);
    }
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::MotorOff), KNEE as u32));
}

#[test]
fn restarted_node_stops_group() {
    let mut robot = leg();
    let joints = robot.activate();
    robot.disturb("knee restart");
    robot.follow_until(&joints, 150, |robot| robot.cause().is_some());
    assert_eq!(robot.group().cause_joint, KNEE as u32, "{:?}", robot.cause());
}

#[test]
fn lost_node_returns_after_power_cycle() {
    let mut robot = leg();
    family::check_power_cycle(&mut robot, KNEE);
}

/// A request has the id of the estimates that the driver sends by itself: both destroy each other.
#[test]
fn returned_node_is_not_asked_for_estimates() {
    let mut robot = leg();
    robot.disturb("knee power-off");
    robot.steps(10_000);
    robot.disturb("knee ok");
    robot.steps(2000);
    assert_eq!(robot.mode(KNEE), MotorMode::Idle);
    let sent = robot.take_sent_to(NODE.into());
    assert!(sent.iter().all(|sent| sent.frame.id().raw() & 0x1F != 0x09), "the id of the estimates");
}

/// The largest number of turns has no number of radians.
#[test]
fn estimates_beyond_any_number_are_not_used() {
    let mut robot = leg();
    robot.steps(500);
    let [a, b, c, d] = f32::MAX.to_le_bytes();
    for payload in [[a, b, c, d, 0, 0, 0, 0], [0, 0, 0, 0, a, b, c, d]] {
        for _ in 0..5 {
            deliver(&mut robot, 0x09, &payload);
            robot.step();
            let joint = robot.joint(KNEE);
            assert!(joint.position.is_finite() && joint.velocity.is_finite(), "{joint:?}");
        }
    }
}

/// Goal: what a driver sends by itself disturbs nothing. Method: each millisecond a report of it, some
/// of which the factory has off, with a motor that moves.
#[test]
fn unprompted_frames_change_nothing() {
    let running = [0, 0, 0, 0, 8, 0, 0, 0x80];
    for (command, payload) in [(0x01, running), (0x09, [0; 8]), (0x03, [0; 8])] {
        let what = format!("command {command}");
        family::check_unprompted(&mut leg(), KNEE, &what, |robot| deliver(robot, command, &payload));
    }
}

#[test]
fn two_nodes_with_one_id_stop_group() {
    let mut robot = leg();
    let id = FrameId::new(BASE | 0x08).unwrap();
    family::check_duplicate(&mut robot, KNEE, id, &[NODE, 0x7F, 0xFF, 0x7F, 0xF7, 0xFF]);
}

#[test]
fn axis_state_of_another_program_is_foreign() {
    let mut robot = leg();
    robot.steps(100);
    deliver(&mut robot, 0x07, &[8, 0, 0, 0, 0, 0, 0, 0]);
    robot.steps(10);
    assert_eq!([0, KNEE].map(|joint| robot.joint(joint).foreign_commands), [0, 1]);
}

/// Goal: no bytes with the ids of a node move the joint or raise a fault. Method: each command and
/// length but whole heartbeats, errors and states, which the motor may send.
#[test]
fn hostile_frames_of_node_move_nothing() {
    let mut robot = leg();
    let joints = robot.activate();
    let mut byte = 0_u8;
    for command in 0..=0x0B_u16 {
        for length in 0..=8 {
            byte = byte.wrapping_mul(29).wrapping_add(113);
            let is_whole =
                matches!((command, length), (0x01 | 0x03, 8) | (0x08, 6)) || (4..8).contains(&command);
            if !is_whole {
                deliver(&mut robot, command, &[byte; 8][..length]);
            }
            (0..5).for_each(|_| robot.follow(&joints));
        }
    }
    family::check_unmoved(&mut robot, KNEE, &joints);
}

/// Commands and replies have 135 bits at most, and the reply of the MIT motor, with six bytes, 115; 110 frames a second of 135 bits.
#[test]
fn bus_plan_has_unprompted_frames() {
    let plan = &BusPlan::of(&robot::settings(&text()))[0];
    let sent = 110.0 * 135.0 / 1e6;
    let expected = f64::from(135 + 115 + 2 * 135) / 1000.0 + sent;
    assert!((plan.worst_case_utilisation - expected).abs() < 0.001, "{}", plan.worst_case_utilisation);
    assert!((plan.unprompted_utilisation - sent).abs() < 1e-6, "{}", plan.unprompted_utilisation);
}

/// The zero differs after each boot, by 6.4° in the measurement of a user.
#[test]
fn zero_within_reach_is_not_reported_as_lost() {
    let mut robot = leg();
    robot.steps(500);
    robot.operate_joint(Operation::SetZero, KNEE).unwrap();
    robot.steps(50);
    assert!((robot.joint(KNEE).position - 0.2).abs() < 0.01, "{}", robot.joint(KNEE).position);
}
