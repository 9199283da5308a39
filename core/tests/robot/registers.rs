//! Goal: no motor starts before the cycle knows the ends of its codes, whenever it was switched on.
//! Method: simulated Damiao motors whose registers differ from their model, on virtual time.

use motord_bus::{Bus, Frame, FrameId};
use motord_core::control::Event;
use motord_harness::robot::{self, Meaning, Robot};
use motord_protocol::register;
use motord_shared::message::{JOINT_MISMATCH, JOINT_VALID};
use motord_shared::{JointSetpoint, MotorMode, Operation, Phase, Refusal};
use motord_simulator::MotorSettings;

/// The id of requests to registers.
const REQUEST: u16 = 0x7FF;

/// One DM-J4310 (12.5 rad, 30 rad/s, 10 N·m) with further keys, changed by `build`.
fn shoulder(keys: &str, build: impl Fn(&mut MotorSettings)) -> Robot {
    let text = format!(
        "[[bus]]\nname = 'arm'\ntype = 'simulated'\n[[motor]]\nname = 'shoulder'\nbus = 'arm'\nid = 1\nprotocol = 'mit'\n\
         model = 'DM-J4310-2EC'\n{keys}\nlimits = {{ position-rad = [-2.0, 2.0], torque-nm = 6.0 }}\n"
    );
    Robot::built(robot::settings(&text), 3, |_, motors| motors.iter_mut().for_each(&build))
}

/// Its registers as its first owner set them.
fn others(motor: &mut MotorSettings) {
    (motor.ends, motor.initial_position) = (Some([core::f64::consts::PI, 30.0, 20.0]), 0.5);
}

fn enable(robot: &mut Robot) -> Result<(), Refusal> {
    if robot.group().lease == 0 {
        robot.claim()?;
    }
    let joints = robot.hold(20.0, 0.5);
    robot.follow(&joints);
    robot.operate(Operation::Enable).map(drop)
}

/// Accesses a register of the motor 1 as another program on the bus does.
fn access(robot: &Robot, bytes: [u8; 8]) {
    let now = robot.now();
    let frame = Frame::classic(FrameId::new(REQUEST).expect("eleven bits"), bytes);
    robot.buses[0].with(|bus| bus.send(now, &[frame]));
}

fn write_vmax(robot: &Robot, value: f32) {
    let [a, b, c, d] = value.to_le_bytes();
    access(robot, [1, 0, 0x55, register::VMAX, a, b, c, d]);
}

fn wrong(event: &Event) -> Option<u8> {
    if let Event::Registers { wrong, .. } = event { *wrong } else { None }
}

#[test]
fn late_motor_is_read_before_its_start() {
    let mut robot = shoulder("", |motor| {
        others(motor);
        motor.has_power = false;
    });
    robot.steps(500);
    robot.disturb("shoulder on");
    let mut refusals = Vec::new();
    for _ in 0..1000 {
        match enable(&mut robot) {
            Ok(()) => break,
            Err(refusal) => refusals.push(refusal),
        }
    }
    refusals.dedup();
    assert!(refusals.contains(&Refusal::MotorOffline), "{refusals:?}");
    assert!((robot.joint(0).position - 0.5).abs() < 0.001, "{}", robot.joint(0).position);

    let from = robot.joint(0).position;
    for step in 0..1000_u16 {
        let position = from + 0.2 * f32::from(step.min(500)) / 500.0;
        robot.follow(&[JointSetpoint { position, kp: 60.0, kd: 1.0, ..Default::default() }]);
    }
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
    let [truth, reported] = [robot.truth(0).position() as f32, robot.joint(0).position];
    assert!((truth - 0.7).abs() < 0.05 && (truth - reported).abs() < 0.01, "{truth} reported as {reported}");
}

/// Goal: motors whose answers miss the deadline are read. Their requests wait on the bus for the
/// replies of others. Method: three motors on a bus of 1 Mbit/s at 1 kHz; the third answer arrives
/// in the next cycle.
#[test]
fn late_registers_permit_a_start() {
    for latency_us in [50, 80, 98, 110, 120, 150, 200] {
        let motor = |id: u8| {
            format!(
                "[[motor]]\nname = 'm{id}'\nbus = 'arm'\nid = {id}\nprotocol = 'mit'\nmodel = 'DM-J4310-2EC'\n\
                 limits = {{ position-rad = [-2.0, 2.0], torque-nm = 6.0 }}\n\
                 simulation = {{ reply-latency-us = {latency_us} }}\n"
            )
        };
        let motors: String = (1..=3).map(motor).collect();
        let text = format!("[[bus]]\nname = 'arm'\ntype = 'simulated'\n{motors}");
        let mut robot = Robot::built(robot::settings(&text), 3, |_, _| {});
        let started = (0..200).any(|_| enable(&mut robot).is_ok());
        assert!(started, "{latency_us} us: {:?}", [0, 1, 2].map(|joint| robot.joint(joint).late));
    }
}

#[test]
fn no_state_is_published_before_registers() {
    let mut robot = shoulder("", others);
    for _ in 0..20 {
        robot.step();
        let joint = robot.joint(0);
        let is_valid = joint.flags & JOINT_VALID != 0;
        assert!(!is_valid || (joint.position - 0.5).abs() < 0.001, "{}", joint.position);
    }
    assert_ne!(robot.joint(0).flags & JOINT_VALID, 0);
    let read = |sent: &robot::Sent| sent.id == REQUEST;
    assert_eq!(robot.take_sent().iter().filter(|sent| read(sent)).count(), 3, "each register once");
}

/// A torque of 2 N·m is 2 N·m at the shaft, whatever TMAX is.
#[test]
fn commanded_torque_uses_reported_ends() {
    let mut robot = shoulder("", |motor| {
        others(motor);
        (motor.coulomb_friction, motor.viscous_friction) = (0.0, 0.0);
        motor.load_inertia = 10.0;
    });
    robot.activate();
    for _ in 0..200 {
        robot.follow(&[JointSetpoint { torque: 2.0, ..Default::default() }]);
    }
    let torque = robot.joint(0).torque;
    assert!((torque - 2.0).abs() < 0.05, "{torque}");
    assert!((robot.truth(0).torque() - 2.0).abs() < 0.05, "{}", robot.truth(0).torque());
}

#[test]
fn written_end_refuses_motor_with_another() {
    let mut robot = shoulder("velocity-end-rad-s = 30", |motor| motor.ends = Some([12.5, 50.0, 10.0]));
    robot.steps(100);
    assert_eq!(enable(&mut robot).unwrap_err(), Refusal::Mismatch);
    assert_ne!(robot.joint(0).flags & JOINT_MISMATCH, 0);
    let wrong_ones: Vec<_> = robot.take_events().iter().filter_map(wrong).collect();
    assert_eq!(wrong_ones, [1], "VMAX, once");

    // The vendor's tool corrects it.
    write_vmax(&robot, 30.0);
    robot.steps(1100);
    enable(&mut robot).expect("it is the configured motor now");
}

#[test]
fn motor_whose_ends_lie_within_limits_is_refused() {
    let mut robot = shoulder("", |motor| motor.ends = Some([12.5, 30.0, 5.0]));
    robot.steps(100);
    assert_eq!(enable(&mut robot).unwrap_err(), Refusal::Mismatch);
}

#[test]
fn nonsense_in_registers_refuses_the_motor() {
    for end in [0.0, -12.5, f64::NAN, f64::INFINITY, 1e30, 1e-30] {
        let mut robot = shoulder("", |motor| motor.ends = Some([12.5, end, 10.0]));
        robot.steps(100);
        assert_eq!(enable(&mut robot).unwrap_err(), Refusal::Mismatch, "{end}");
        assert!(robot.joint(0).position.is_nan(), "{end}");
    }
}

#[test]
fn motor_is_read_again_after_silence() {
    let mut robot = shoulder("", |_| {});
    let joints = robot.activate();
    robot.disturb("shoulder power-off");
    robot.follow_until(&joints, 100, |robot| robot.phase() == Phase::Disarmed);
    robot.disturb("shoulder on");
    robot.steps(600);
    let reads = robot.take_sent().iter().filter(|sent| sent.id == REQUEST).count();
    assert_eq!(reads, 3, "each register once");

    write_vmax(&robot, 10.0);
    robot.steps(5);
    robot.disturb("shoulder power-off");
    robot.steps(50);
    robot.disturb("shoulder on");
    robot.steps(600);
    let wrong_ones: Vec<_> = robot.take_events().iter().filter_map(wrong).collect();
    assert_eq!(wrong_ones, [1], "the limit of 20.9 rad/s is beyond VMAX 10");
}

/// A drive with old firmware: it ignores requests to registers.
#[test]
fn motor_without_answer_is_asked_once_a_second() {
    let mut robot = shoulder("", |motor| motor.ends = None);
    robot.steps(100);
    assert_eq!(enable(&mut robot).unwrap_err(), Refusal::Unread);
    assert_eq!(robot.mode(0), MotorMode::Idle, "it answers");
    assert!(robot.joint(0).position.is_nan(), "and its states have no meaning");
    robot.take_sent();
    robot.steps(10_000);
    let asked = robot.take_sent().iter().filter(|sent| sent.id == REQUEST).count();
    assert!((9..=11).contains(&asked), "{asked}");
    let events = robot.take_events();
    let count = |is: fn(&&Event) -> bool| events.iter().filter(is).count();
    assert_eq!(count(|event| matches!(event, Event::Unread { motor: 0, is_assumed: false })), 1);
    assert_eq!(count(|event| matches!(event, Event::Silent { .. })), 0, "it is not silent");
    assert_eq!(robot.joint(0).missed, 0, "no reply was missed");
}

const WRITTEN: &str = "position-end-rad = 12.5\nvelocity-end-rad-s = 30\ntorque-end-nm = 10";

/// A drive with old firmware, whose ends its owner knows.
#[test]
fn motor_without_answer_starts_with_written_ends() {
    let mut robot = shoulder(WRITTEN, |motor| (motor.ends, motor.initial_position) = (None, 0.5));
    robot.steps(900);
    assert_eq!(enable(&mut robot).unwrap_err(), Refusal::Unread, "not before it was asked for a second");
    robot.steps(300);
    let joint = robot.joint(0);
    assert!((joint.position - 0.5).abs() < 0.001 && joint.flags & JOINT_MISMATCH == 0, "{joint:?}");
    enable(&mut robot).expect("all ends are written");
    robot.take_sent();
    let torque = JointSetpoint { torque: 2.0, ..Default::default() };
    (0..300).for_each(|_| robot.follow(&[torque]));
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
    let sent = robot.take_sent();
    assert!(sent.iter().all(|sent| sent.id != REQUEST), "a motor that moves is never asked");
    // DM_CAN.py: 12 bits for -TMAX to TMAX, so 2 N·m is (2 + 10) / 20 · 4095.
    let [.., high, low] = sent.last().expect("it is commanded").bytes;
    assert_eq!(u16::from_be_bytes([high & 0x0F, low]), 2457);
    let events = robot.take_events();
    let count = |is: fn(&&Event) -> bool| events.iter().filter(is).count();
    assert_eq!(count(|event| matches!(event, Event::Unread { motor: 0, is_assumed: true })), 1);
}

/// The motor contradicts the written ends, has no power for some time, and its answers to requests
/// are lost afterwards.
#[test]
fn contradicted_ends_are_not_assumed_after_silence() {
    let mut robot = shoulder(WRITTEN, |motor| motor.ends = Some([12.5, 50.0, 10.0]));
    robot.steps(100);
    assert_eq!(enable(&mut robot).unwrap_err(), Refusal::Mismatch);
    robot.disturb("shoulder power-off");
    robot.steps(50);
    let mute = shoulder(WRITTEN, |motor| motor.ends = None);
    let swap_motors = |robot: &Robot| {
        robot.buses[0].with(|bus| mute.buses[0].with(|other| core::mem::swap(bus, other)));
    };
    swap_motors(&robot);
    robot.take_events();
    robot.steps(2500);
    let is_unread = |event: &Event| matches!(event, Event::Unread { motor: 0, is_assumed: false });
    assert_eq!(robot.take_events().iter().filter(|event| is_unread(event)).count(), 1);
    assert_eq!(enable(&mut robot).unwrap_err(), Refusal::Mismatch, "VMAX is 50, by its last answer");
    assert!(robot.joint(0).position.is_nan(), "its states have no meaning");

    // The vendor's tool corrects the motor, and its answers arrive again.
    robot.disturb("shoulder power-off");
    robot.steps(50);
    swap_motors(&robot);
    robot.disturb("shoulder on");
    robot.steps(600);
    write_vmax(&robot, 30.0);
    robot.steps(1100);
    enable(&mut robot).expect("it reported the written ends");
}

#[test]
fn motor_without_answer_needs_all_ends_written() {
    for left_out in 0..3 {
        let mut keys: Vec<_> = WRITTEN.lines().collect();
        keys.remove(left_out);
        let mut robot = shoulder(&keys.join("\n"), |motor| motor.ends = None);
        robot.steps(3000);
        assert_eq!(enable(&mut robot).unwrap_err(), Refusal::Unread, "{keys:?}");
        assert!(robot.joint(0).position.is_nan(), "{keys:?}");
    }
}

#[test]
fn lost_register_request_is_repeated_at_once() {
    for seed in 0..20 {
        let text = "[[bus]]\nname = 'arm'\ntype = 'simulated'\n[[motor]]\nname = 'shoulder'\nbus = 'arm'\nid = 1\nprotocol = 'mit'\n\
                    model = 'DM-J4310-2EC'\nlimits = { position-rad = [-2.0, 2.0] }\n";
        let mut robot = Robot::built(robot::settings(text), seed, |_, motors| others(&mut motors[0]));
        robot.disturb("shoulder intermittent 30%");
        robot.steps(60);
        robot.disturb("shoulder ok");
        robot.steps(1100);
        assert!((robot.joint(0).position - 0.5).abs() < 0.001, "seed {seed}: {}", robot.joint(0).position);
    }
}

/// Another program reads registers on the bus of an active group: its answers are no states, and no
/// second motor.
#[test]
fn register_answers_of_another_program_change_nothing() {
    let mut robot = shoulder("", |_| {});
    let joints = robot.activate();
    let before = robot.joint(0).position;
    for cycle in 0..300_u16 {
        access(&robot, register::read(1, (cycle % 82) as u8));
        robot.follow(&joints);
        assert!((robot.joint(0).position - before).abs() < 0.01, "{}", robot.joint(0).position);
    }
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
}

/// The motors of a bus that was opened again may be others.
#[test]
fn reopened_bus_is_read_before_the_next_start() {
    let mut robot = shoulder("", |_| {});
    let joints = robot.activate();
    robot.reopen(0);
    (0..100).for_each(|_| robot.follow(&joints));
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
    let reads = |robot: &mut Robot| robot.take_sent().iter().filter(|sent| sent.id == REQUEST).count();
    assert_eq!(reads(&mut robot), 0, "a motor that moves is never asked");
    robot.operate(Operation::Disable).unwrap();
    robot.steps(3000);
    let sent = robot.take_sent();
    let first = sent.iter().position(|sent| sent.id == REQUEST).expect("it is read");
    assert_eq!(sent[first - 1].meaning, Meaning::Stop, "the motor confirmed its stop before");
    let count = sent.iter().filter(|sent| sent.id == REQUEST).count();
    assert_eq!((robot.phase(), count), (Phase::Disarmed, 3));
    enable(&mut robot).unwrap();
}
