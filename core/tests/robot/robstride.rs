//! RobStride's private protocol in the cycle, beside MIT motors on one bus, on virtual time.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use super::family;
use motord_bus::{Bus, Frame, FrameId};
use motord_core::drive::safe_frames;
use motord_harness::robot::{self, Meaning, Robot};
use motord_protocol::Faults;
use motord_settings::plan::BusPlan;
use motord_shared::{Cause, MotorMode, Phase};

/// Index of the private motor.
const KNEE: usize = 1;

fn text() -> String {
    family::leg(family::ROBSTRIDE)
}

fn leg() -> Robot {
    Robot::new(robot::settings(&text()), 3)
}

/// Returns the id of a frame from the knee to the host.
fn from_knee(kind: u32, status: u32) -> FrameId {
    FrameId::extended(kind << 24 | status << 16 | 0x05FD).unwrap()
}

/// A state in the middle of the codes, 25.0 °C.
const REST: [u8; 8] = [0x7D, 0xF7, 0x80, 0x00, 0x80, 0x00, 0x00, 0xFA];

#[test]
fn private_motor_follows_beside_mit_motor() {
    let mut robot = leg();
    family::check_wave(&mut robot, KNEE, 0.05);
    let true_position = robot.truth(KNEE).position();
    let joint = robot.joint(KNEE);
    assert!((f64::from(joint.position) - (0.2 - true_position)).abs() < 0.01, "direction and offset");
    assert!((joint.temperature - 25.0).abs() < 2.0 && joint.fault == 0);
    let bus = robot.bus(0);
    assert_eq!((bus.malformed, bus.duplicate, bus.unexpected_id), (0, 0, 0));
}

#[test]
fn stop_damps_then_disables_private_motor() {
    let mut robot = leg();
    let sent = family::check_stop(&mut robot, KNEE, 5);
    assert_eq!(sent.last().unwrap().meaning, Meaning::Stop);
}

/// The frames of the dead man's switch and of `safe-stop`.
#[test]
fn safe_frames_damp_and_stop_private_motor() {
    let settings = robot::settings(&text());
    let (damp, stop) = safe_frames(&settings.motors[KNEE]).unwrap();
    // Damping of 2 N·m·s/rad is 26214 of 65535, 0x6666, at the middle of position, velocity, torque.
    for frame in damp {
        assert_eq!(frame.id(), FrameId::extended(0x0180_0005).unwrap());
        assert_eq!(frame.payload()[2..], [0x80, 0x00, 0x00, 0x00, 0x66, 0x66]);
    }
    assert_eq!((stop.id(), stop.payload()), (FrameId::extended(0x0400_FD05).unwrap(), &[0; 8][..]));
}

#[test]
fn faults_in_state_stop_group_and_are_cleared() {
    // Under-voltage, stall and hot winding by the id of a state.
    for (number, fault) in
        [("0x04", Faults::UNDER_VOLTAGE), ("0x4000", Faults::OVERLOAD), ("0x80", Faults::ENCODER)]
    {
        let mut robot = leg();
        let joints = robot.activate();
        robot.disturb(&format!("knee fault {number}"));
        robot.follow_until(&joints, 5, |robot| robot.cause().is_some());
        assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::MotorFault), KNEE as u32));
        assert_eq!((robot.joint(KNEE).fault, robot.mode(KNEE)), (fault.0, MotorMode::Fault), "{number}");
        family::check_clearing(&mut robot, KNEE, fault.0);
    }
}

/// No bit of a state stands for an over-voltage.
#[test]
fn fault_report_names_fault_until_cleared() {
    let mut robot = leg();
    let joints = robot.activate();
    robot.disturb("knee fault 0x08");
    robot.follow_until(&joints, 5, |robot| robot.cause().is_some());
    (0..100).for_each(|_| robot.follow(&joints));
    let joint = robot.joint(KNEE);
    assert_eq!((joint.fault, robot.mode(KNEE)), (Faults::OVER_VOLTAGE.0, MotorMode::Fault));
    family::check_clearing(&mut robot, KNEE, Faults::OVER_VOLTAGE.0);
}

/// A drive that restarts too fast for a silence reports mode 0.
#[test]
fn private_motor_reporting_reset_is_motor_off() {
    let mut robot = leg();
    let joints = robot.activate();
    robot.disturb("knee restart");
    robot.follow_until(&joints, 20, |robot| robot.cause().is_some());
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::MotorOff), KNEE as u32));
}

#[test]
fn lost_private_motor_returns_after_power_cycle() {
    let mut robot = leg();
    family::check_power_cycle(&mut robot, KNEE);
}

#[test]
fn heat_of_private_motor_stops_group() {
    let mut robot = leg();
    let joints = robot.activate();
    robot.disturb("knee temperature 95");
    (0..1100).for_each(|_| robot.follow(&joints));
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::OverTemperature), KNEE as u32));
}

/// Goal: a motor that reports unasked disturbs nothing. Method: every 10 ms a state of either type
/// at each time of a cycle, a version, a parameter for another program, and warnings.
#[test]
fn unprompted_frames_change_nothing() {
    for (kind, payload) in [
        (24, REST),
        (2, REST),
        (2, [0x00, 0xC4, 0x56, 3, 5, 3, 7, 0]),
        (17, [0x28, 0x70, 0, 0, 0, 0, 0, 0]),
        (21, [0, 0, 0, 0, 1, 0, 0, 0]),
    ] {
        let mut robot = leg();
        let joints = robot.activate();
        for cycle in 0..3000 {
            if cycle % 10 == 0 {
                robot.deliver_with_id(0, from_knee(kind, 0x80), &payload);
            }
            robot.follow(&joints);
        }
        assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None), "type {kind} {payload:?}");
        let bus = robot.bus(0);
        assert_eq!((bus.malformed, bus.duplicate, bus.unexpected_id), (0, 0, 0), "type {kind} {payload:?}");
        assert_eq!((robot.joint(KNEE).fault, robot.joint(KNEE).late), (0, 0), "type {kind}");
        assert!((robot.joint(KNEE).temperature - 25.0).abs() < 2.0, "type {kind} {payload:?}");
    }
}

#[test]
fn reporting_motor_is_used_as_any_other() {
    let mut robot = leg();
    robot.steps(100);
    // Type 24, F_CMD 1, as the vendor's tool sends it.
    let frame = Frame::classic(FrameId::extended(0x1800_FD05).unwrap(), [1, 2, 3, 4, 5, 6, 1, 0]);
    let now = robot.now();
    robot.buses[0].bus().lock().send(now, &[frame]);
    let joints = robot.activate();
    robot.take_replies();
    (0..1000).for_each(|_| robot.follow(&joints));
    let reports = robot.take_replies().iter().filter(|reply| reply.frame.id().raw() >> 24 == 24).count();
    assert!((90..=100).contains(&reports), "{reports}");
    assert_eq!((robot.phase(), robot.bus(0).duplicate, robot.bus(0).malformed), (Phase::Active, 0, 0));
}

#[test]
fn two_private_motors_with_one_id_stop_group() {
    let mut robot = leg();
    family::check_duplicate(&mut robot, KNEE, from_knee(2, 0x80), &REST);
}

#[test]
fn command_of_another_program_is_foreign() {
    let mut robot = leg();
    robot.steps(100);
    robot.deliver_with_id(0, FrameId::extended(0x0300_0005).unwrap(), &[0; 8]);
    robot.steps(10);
    assert_eq!([0, KNEE].map(|joint| robot.joint(joint).foreign_commands), [0, 1]);
}

/// Goal: no bytes with the ids of a motor stop the robot or raise a fault. Method: each type and
/// length but states and fault reports, which the motor may send.
#[test]
fn hostile_private_frames_move_nothing() {
    let mut robot = leg();
    let joints = robot.activate();
    let mut byte = 0_u8;
    for kind in (0..=31).filter(|kind| !matches!(kind, 2 | 21)) {
        for length in 0..=8 {
            byte = byte.wrapping_mul(29).wrapping_add(113);
            robot.deliver_with_id(0, from_knee(kind, byte.into()), &[byte; 8][..length]);
            (0..5).for_each(|_| robot.follow(&joints));
        }
    }
    family::check_unmoved(&mut robot, KNEE, &joints);
}

/// A frame of 8 bytes has at most 160 bits with an id of 29 bits, and 135 with one of 11; a reply of
/// SteadyWin has 115 (Davis and others, 2007).
#[test]
fn bus_plan_has_frames_of_29_bits() {
    let plan = &BusPlan::of(&robot::settings(&text()))[0];
    let expected = f64::from(160 * 2 + 135 + 115) / 1000.0;
    assert!((plan.worst_case_utilisation - expected).abs() < 0.001, "{}", plan.worst_case_utilisation);
}

/// A joint without stiffness that turns on beyond the end of the codes, which the motor wraps.
#[test]
fn position_of_private_motor_is_unwrapped() {
    family::check_unwrapping(&text(), KNEE);
}
