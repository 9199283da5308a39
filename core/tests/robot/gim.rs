//! The cycle with motors in native mode, on virtual time.

use super::reply_with;
use motord_bus::{Bus, Duration, Inbox, Instant};
use motord_core::drive::{Drive, Received};
use motord_harness::robot;
use motord_harness::robot::Robot;
use motord_protocol::drive::{Command, Reported};
use motord_protocol::gim::INDICATORS;
use motord_shared::{Cause, Indicator, JointSetpoint, MotorMode, Operation, Phase, Refusal, SetpointMode};
use motord_simulator::DurationEnd;

/// The code of Stop Motor, CID 0x92.
const STOP: u8 = 0x92;

fn arm() -> Robot {
    let mut text =
        String::from("[safety]\nsetpoint-timeout-ms = 20\n[[bus]]\nname = \"can\"\ntype = \"simulated\"\n");
    for (id, name) in [(1, "shoulder"), (2, "elbow")] {
        text += &robot::motor(id, name, "can", "").replace("\"mit\"", "\"gim\"");
    }
    Robot::new(robot::settings(&text), 1)
}

/// Returns setpoints of one mode, with `value` in its field, for both joints.
fn setpoints(mode: SetpointMode, value: f32) -> Vec<JointSetpoint> {
    let mut joint = JointSetpoint { mode: mode.code(), ..Default::default() };
    match mode {
        SetpointMode::Torque => joint.torque = value,
        SetpointMode::Speed => joint.velocity = value,
        SetpointMode::Position | SetpointMode::Impedance => joint.position = value,
    }
    vec![joint; 2]
}

fn activate(robot: &mut Robot, joints: &[JointSetpoint]) {
    robot.steps(300);
    assert_eq!([robot.mode(0), robot.mode(1)], [MotorMode::Idle; 2], "they report their angle while stopped");
    robot.claim().expect("the group is free");
    robot.follow(joints);
    robot.operate(Operation::Enable).expect("all is well");
    for _ in 0..60 {
        robot.follow(joints);
    }
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
}

#[test]
fn gim_motors_follow_torque_speed_and_position() {
    for (mode, value) in
        [(SetpointMode::Torque, 0.5), (SetpointMode::Speed, 2.0), (SetpointMode::Position, 0.05)]
    {
        let mut robot = arm();
        let joints = setpoints(mode, value);
        activate(&mut robot, &joints);
        for _ in 0..500 {
            robot.follow(&joints);
        }
        assert_eq!(robot.phase(), Phase::Active, "{mode}: {:?}", robot.cause());
        let joint = robot.joint(0);
        match mode {
            SetpointMode::Speed => assert!((joint.velocity - value).abs() < 0.5, "{}", joint.velocity),
            SetpointMode::Position => assert!((joint.position - value).abs() < 0.02, "{}", joint.position),
            _ => assert!(joint.position > 0.1, "{}", joint.position),
        }
        assert!(joint.temperature.is_finite(), "native replies contain a temperature");
    }
}

#[test]
fn gim_motors_are_damped_when_their_owner_dies() {
    let mut robot = arm();
    let joints = setpoints(SetpointMode::Speed, 3.0);
    activate(&mut robot, &joints);
    for _ in 0..600 {
        robot.follow(&joints);
    }
    let before = robot.joint(0).velocity;
    robot.steps(25);
    assert_eq!(robot.cause(), Some(Cause::SetpointTimeout));
    robot.steps(200);
    assert!(robot.joint(0).velocity.abs() < 0.2 * before, "{before} became {}", robot.joint(0).velocity);
    robot.steps(2500);
    assert_eq!(robot.phase(), Phase::Disarmed);
    robot.steps(3);
    assert_eq!(robot.cycle.unstopped().count(), 0, "they answered their stops");
}

/// Otherwise the motor keeps its last torque for the nine turns that ask for its state.
#[test]
fn stop_is_repeated_until_native_motor_confirms() {
    let robot = arm();
    let mut drive = Drive::new(&robot.settings.motors[0], Duration::ZERO, false);
    let at = |turn: u64| Instant::ZERO + Duration::from_millis(10 * turn);
    let first = |drive: &mut Drive, turn| drive.request(&Command::Stop, at(turn)).unwrap().payload()[0];
    drive.request(&Command::Start, Instant::ZERO);
    assert_eq!(first(&mut drive, 1), STOP);
    drive.withdraw();
    assert_eq!(first(&mut drive, 2), STOP, "the one before was not sent");
    let lost: Vec<_> = (3..9).map(|turn| first(&mut drive, turn) == STOP).collect();
    assert_eq!(lost, [false, true, false, true, false, true]);
    let confirmed =
        drive.receive(&reply_with(&[STOP, 0, 0, 0, 0, 0, 0, 0]), at(8) + Duration::from_millis(1));
    assert_eq!(confirmed, Received::Reply(Reported::Stopped));
    let confirmed = (9..29).filter(|turn| first(&mut drive, *turn) == STOP).count();
    assert_eq!(confirmed, 2, "a stop in every tenth turn");
}

/// It hears, but its answers are lost: only repeated stops end its torque.
#[test]
fn lost_native_motor_gets_five_stops_a_second() {
    let mut robot = arm();
    let joints = setpoints(SetpointMode::Torque, 0.5);
    activate(&mut robot, &joints);
    robot.disturb("shoulder off");
    robot.steps(100);
    assert_eq!(robot.mode(0), MotorMode::Offline);
    robot.take_sent();
    robot.steps(1000);
    let stops = robot.take_sent_to(1).iter().filter(|sent| sent.bytes[0] == STOP).count();
    assert!(stops >= 4, "{stops}");
}

#[test]
fn unreadable_request_is_refused_once_without_waiting() {
    let robot = arm();
    let mut drive = Drive::new(&robot.settings.motors[0], Duration::ZERO, false);
    drive.request(&Command::Start, Instant::ZERO);
    assert_eq!(drive.refuse(), Received::Reply(Reported::Refused));
    assert!(!drive.is_open());
    assert_eq!(drive.refuse(), Received::Malformed, "nothing was asked");
}

#[test]
fn impossible_winding_temperature_is_not_believed_once() {
    let mut robot = arm();
    let joints = setpoints(SetpointMode::Torque, 0.0);
    activate(&mut robot, &joints);
    for _ in 0..20 {
        robot.disturb("shoulder temperature 95");
        robot.follow(&joints);
        assert!(robot.joint(0).temperature < 40.0, "{} °C", robot.joint(0).temperature);
        robot.disturb("shoulder temperature 25");
        robot.follow(&joints);
    }
    assert_eq!(robot.phase(), Phase::Active);
}

#[test]
fn motor_too_hot_for_a_second_stops_group() {
    let mut robot = arm();
    let joints = setpoints(SetpointMode::Torque, 0.0);
    activate(&mut robot, &joints);
    robot.disturb("elbow temperature 95");
    for _ in 0..990 {
        robot.follow(&joints);
    }
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
    for _ in 0..50 {
        robot.follow(&joints);
    }
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::OverTemperature), 1));
}

/// Goal: heat before a stop does not forbid to enable the group for ever. A stopped GIM motor does
/// not report its temperature.
#[test]
fn cooled_native_motor_starts_again() {
    let mut robot = arm();
    let joints = setpoints(SetpointMode::Torque, 0.0);
    activate(&mut robot, &joints);
    robot.disturb("elbow temperature 95");
    robot.follow_until(&joints, 1100, |robot| robot.cause().is_some());
    assert_eq!(robot.cause(), Some(Cause::OverTemperature));
    robot.steps(500);
    robot.disturb("elbow temperature 25");
    robot.steps(2000);
    let stopped = robot.joint(1).temperature;
    robot.operate(Operation::Reset).expect("it is at rest");
    activate(&mut robot, &joints);
    assert!(robot.joint(1).temperature < 40.0, "{} °C", robot.joint(1).temperature);
    assert!(stopped.is_nan(), "{stopped} °C were not reported");
}

/// A drive that follows a speed produces the torque that it needs, so its torque cannot be reduced.
#[test]
fn autonomous_drive_is_stopped_before_winding_overheats() {
    let mut text = String::from("[[bus]]\nname = \"can\"\ntype = \"simulated\"\n");
    for (id, name) in [(1, "shoulder"), (2, "elbow")] {
        text += &robot::motor(id, name, "can", "overload-seconds = 1.0").replace("\"mit\"", "\"gim\"");
    }
    let mut robot = Robot::built(robot::settings(&text), 1, |_, motors| {
        motors[0].coulomb_friction = 15.0;
    });
    let joints = setpoints(SetpointMode::Speed, 2.0);
    activate(&mut robot, &joints);
    robot.follow_until(&joints, 3000, |robot| robot.phase() != Phase::Active);
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::OverTemperature), 0));
    assert!(robot.joint(0).temperature < robot.settings.motors[0].limits.temperature, "the model was first");
}

/// Returns the arm's joints that follow setpoints of one mode, in turns of 10 ms, with this load on
/// the shafts. Goal: the torque before a stop heats no model of the winding afterwards, which
/// refused to enable the group. A stopped GIM motor reports only its angle and speed.
#[test]
fn stopped_native_motor_reports_no_torque() {
    let mut robot = arm();
    let joints = setpoints(SetpointMode::Torque, 3.0);
    activate(&mut robot, &joints);
    robot.follow(&joints);
    assert!(robot.joint(0).torque > 1.0, "{}", robot.joint(0).torque);
    robot.disturb("shoulder power-cycle");
    robot.steps(2000);
    assert_eq!((robot.mode(0), robot.joint(0).torque), (MotorMode::Idle, 0.0));
}

fn shipped_arm(mode: SetpointMode, load_inertia: f64) -> (Robot, Vec<JointSetpoint>) {
    let settings = robot::settings(include_str!("../../../config/arm-native.toml"));
    let mut robot = Robot::built(settings, 1, |_, motors| {
        motors.iter_mut().for_each(|motor| motor.load_inertia = load_inertia);
    });
    robot.steps(1000);
    for joint in 0..4 {
        assert_eq!(robot.mode(joint), MotorMode::Idle, "joint {joint}");
    }
    robot.claim().expect("the group is free");
    let mut joints = robot.hold(0.0, 0.0);
    joints.iter_mut().for_each(|joint| joint.mode = mode.code());
    robot.follow(&joints);
    robot.operate(Operation::Enable).expect("all is well");
    robot.follow_until(&joints, 500, |robot| robot.phase() == Phase::Active);
    (robot, joints)
}

/// Goal: the motors of the shipped arm follow steps of the setpoints within their range, over a
/// line at 100 Hz.
/// Method: each joint gets a setpoint in its range, for the wrist farther than its permitted
/// following error. It must be there a second later.
#[test]
fn shipped_arm_follows_position_steps_over_line() {
    for size in [0.15, 0.3, 1.0] {
        let (mut robot, mut joints) = shipped_arm(SetpointMode::Position, 0.01);
        let targets = [size, -size, size];
        joints.iter_mut().zip(targets).for_each(|(joint, target)| joint.position = target);
        (0..1000).for_each(|_| robot.follow(&joints));
        assert_eq!(robot.phase(), Phase::Active, "{size} rad: {:?}", robot.cause());
        for (joint, target) in targets.iter().enumerate() {
            let there = robot.joint(joint).position;
            assert!((there - target).abs() < 0.02, "joint {joint} is at {there}, {size} rad were asked for");
        }
    }
}

/// Goal: a stop brakes a native joint, however long its turns are and however light it is.
/// Method: the wrist of the shipped arm turns at 2 rad/s, alone or with a load, at the time of the
/// stop. Its shaft must slow down in every cycle, and must not turn back.
#[test]
fn stop_brakes_native_joint_at_100_hz() {
    for load_inertia in [1e-6, 0.01, 0.3] {
        let (mut robot, mut joints) = shipped_arm(SetpointMode::Speed, load_inertia);
        joints[2].velocity = 2.0;
        (0..400).for_each(|_| robot.follow(&joints));
        robot.operate(Operation::EmergencyStop).expect("always");
        robot.steps(20);
        let mut fastest = robot.truth(2).velocity();
        assert!(fastest > 1.0, "{fastest}");
        while robot.phase() == Phase::Damping {
            robot.step();
            let velocity = robot.truth(2).velocity();
            assert!(velocity > -0.05 && velocity < fastest + 0.05, "{load_inertia} kg·m²: {velocity}");
            fastest = fastest.min(velocity);
        }
        assert!(fastest < 0.1, "{load_inertia} kg·m²: {fastest} rad/s when its stop was over");
    }
}

/// Goal: a braked joint receives no command that drives it, with or without states.
/// Method: its motor becomes silent. Until it is lost, the commanded speeds fall from its speed to
/// zero.
#[test]
fn silent_native_joint_brakes_with_falling_speeds() {
    let mut robot = arm();
    let joints = setpoints(SetpointMode::Torque, 0.3);
    activate(&mut robot, &joints);
    (0..500).for_each(|_| robot.follow(&joints));
    let begun = robot.joint(0).velocity;
    assert!(begun > 1.0, "{begun}");
    robot.operate(Operation::EmergencyStop).expect("always");
    robot.steps(2);
    robot.disturb("shoulder off");
    robot.take_sent();
    robot.steps(5);
    let sent = robot.take_sent_to(1);
    let speeds: Vec<_> = sent.iter().filter_map(|sent| value(0x94, sent)).collect();
    assert!(speeds.len() >= 4, "{sent:?}");
    assert!(speeds.is_sorted_by(|before, after| before > after && *after > 0.0), "{speeds:?}");
}

/// A damped joint under a load sinks until it reaches a support. A braked one stops, and would
/// fall.
#[test]
fn native_joint_is_released_at_rest_or_timeout() {
    for (load, least, most) in [(0.0, 0.05, 0.5), (3.0, 1.99, 2.1)] {
        let mut text = String::from("[[bus]]\nname = \"can\"\ntype = \"simulated\"\n");
        for (id, name) in [(1, "shoulder"), (2, "elbow")] {
            text += &robot::motor(id, name, "can", "").replace("\"mit\"", "\"gim\"");
        }
        let mut robot = Robot::new(robot::settings(&text), 1);
        let joints = setpoints(SetpointMode::Speed, 0.0);
        activate(&mut robot, &joints);
        robot.disturb(&format!("shoulder load {load}"));
        (0..50).for_each(|_| robot.follow(&joints));
        robot.operate(Operation::EmergencyStop).expect("always");
        let begun = robot.now();
        robot.step();
        while robot.phase() == Phase::Damping {
            robot.step();
        }
        let seconds = robot.now().since(begun).as_secs_f64();
        assert!((least..=most).contains(&seconds), "{load} N·m: let go after {seconds} s");
    }
}

/// 20 rad/s in half a second are 0.04 rad/s in a cycle; 1 rad/s is 60 / 2π rpm. The velocity of a
/// torque setpoint has no meaning.
#[test]
fn speed_setpoint_starts_at_present_speed() {
    let mut robot = arm();
    let mut joints = setpoints(SetpointMode::Torque, 0.0);
    joints.iter_mut().for_each(|joint| joint.velocity = 15.0);
    activate(&mut robot, &joints);
    robot.take_sent();
    joints.iter_mut().for_each(|joint| joint.mode = SetpointMode::Speed.code());
    robot.follow(&joints);
    let sent = robot.take_sent_to(1);
    let speeds: Vec<_> = sent.iter().filter_map(|sent| value(0x94, sent)).collect();
    assert!(matches!(speeds[..], [rpm] if rpm.abs() < 2.0 * 0.04 * 9.55), "{speeds:?} rpm");
}

fn stiff(position: f32, kp: f32) -> Vec<JointSetpoint> {
    vec![JointSetpoint { position, kp, kd: 1.0, ..Default::default() }; 2]
}

/// Returns the value of a control command (GIM document, 3.2.7 to 3.2.9).
fn value(command: u8, sent: &robot::Sent) -> Option<f32> {
    let [first, a, b, c, d, ..] = sent.bytes;
    (first == command).then_some(f32::from_le_bytes([a, b, c, d]))
}

/// Returns the torque of a torque command, N·m.
fn commanded_torque(sent: &robot::Sent) -> Option<f32> {
    value(0x93, sent)
}

#[test]
fn impedance_setpoints_hold_a_native_joint() {
    let mut robot = arm();
    activate(&mut robot, &stiff(0.05, 30.0));
    robot.take_sent();
    let joints = stiff(0.3, 30.0);
    for _ in 0..800 {
        robot.follow(&joints);
    }
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
    let joint = robot.joint(0);
    assert!((joint.position - 0.3).abs() < 0.02, "{}", joint.position);
    assert_eq!((joint.applied.kp, joint.applied.position), (30.0, 0.3), "clients see what they asked for");
    let sent = robot.take_sent_to(1);
    assert!(sent.iter().all(|sent| [0x93, 0xB2, 0xB4].contains(&sent.bytes[0])), "torques and questions");
}

/// 40 N·m/rad over 0.1 rad, from a state that no other follows: its age is one turn, then two,
/// three, four.
#[test]
fn older_state_gives_less_computed_stiffness() {
    let mut robot = arm();
    let joints = stiff(0.0, 40.0);
    activate(&mut robot, &joints);
    let joints = stiff(0.1, 40.0);
    for _ in 0..20 {
        robot.follow(&joints);
    }
    robot.disturb("shoulder off");
    robot.follow(&joints);
    robot.take_sent();
    let mut torques = Vec::new();
    for _ in 0..4 {
        robot.follow(&joints);
        torques.extend(robot.take_sent_to(1).iter().filter_map(commanded_torque));
    }
    let ratios: Vec<_> = torques.windows(2).map(|pair| pair[1] / pair[0]).collect();
    assert_eq!(ratios.len(), 3, "{torques:?}");
    for (ratio, turns) in ratios.iter().zip(2_i8..) {
        let expected = f32::from(turns) / f32::from(turns + 1);
        assert!((ratio - expected).abs() < 0.05, "{torques:?}: after {turns} turns");
    }
}

/// Bytes 5 to 7, low byte first (GIM document, 3.2.7 to 3.2.9).
#[test]
fn every_control_command_says_how_long_it_lasts() {
    for (mode, code) in
        [(SetpointMode::Torque, 0x93), (SetpointMode::Speed, 0x94), (SetpointMode::Position, 0x95)]
    {
        let mut text = String::from("[[bus]]\nname = \"can\"\ntype = \"simulated\"\n");
        for (id, name) in [(1, "shoulder"), (2, "elbow")] {
            text += &robot::motor(id, name, "can", "control-duration-ms = 300").replace("\"mit\"", "\"gim\"");
        }
        let mut robot = Robot::new(robot::settings(&text), 1);
        let joints = setpoints(mode, 0.01);
        activate(&mut robot, &joints);
        robot.take_sent();
        (0..50).for_each(|_| robot.follow(&joints));
        let sent = robot.take_sent();
        let commands: Vec<_> = sent.iter().filter(|sent| sent.bytes[0] == code).collect();
        assert!(commands.len() > 90);
        assert!(commands.iter().all(|sent| sent.bytes[5..] == [0x2C, 0x01, 0x00]));
    }
}

/// Goal: a duration that ends the torque lets a killed daemon's motor go limp. Without one, it
/// never does.
/// Method: the cycle stops running, and there is no dead man's switch. Both readings of the
/// document are simulated.
#[test]
fn duration_is_watchdog_if_its_end_is_limp() {
    let cases = [
        (30, DurationEnd::GoesLimp, false),
        (30, DurationEnd::HoldsCommand, true),
        (0, DurationEnd::GoesLimp, true),
    ];
    for (duration_ms, end, drives_on) in cases {
        let mut text = String::from("[[bus]]\nname = \"can\"\ntype = \"simulated\"\n");
        let more = format!("control-duration-ms = {duration_ms}");
        for (id, name) in [(1, "shoulder"), (2, "elbow")] {
            text += &robot::motor(id, name, "can", &more).replace("\"mit\"", "\"gim\"");
        }
        let mut robot = Robot::built(robot::settings(&text), 1, |_, motors| {
            motors.iter_mut().for_each(|motor| motor.behaviour.duration_end = end);
        });
        let joints = setpoints(SetpointMode::Torque, 0.5);
        activate(&mut robot, &joints);
        (0..200).for_each(|_| robot.follow(&joints));
        let killed = robot.now();
        let later = |after: Duration| {
            robot.buses[0].with(|bus| bus.receive(killed + after, &mut Inbox::new()));
            robot.truth(0).velocity()
        };
        assert!(later(Duration::from_millis(20)) > 0.5, "it follows its last command");
        let velocity = later(Duration::from_secs(2));
        assert_eq!(velocity > 1.0, drives_on, "{duration_ms} ms, {end:?}: {velocity} rad/s");
    }
}

/// Bytes: GIM document, 3.2.17. 1.5 V is 0x3FC00000.
#[test]
fn late_indicator_is_kept_apart_from_state() {
    let settings = arm().settings;
    let mut drive = Drive::new(&settings.motors[0], Duration::ZERO, false);
    let at = |millis| Instant::ZERO + Duration::from_millis(millis);
    let asked = drive.request(&Command::GetIndicator(0x13), at(1)).expect("a frame");
    assert_eq!(asked.payload()[..2], [0xB4, 0x13]);
    assert_eq!(drive.request(&Command::Wait, at(2)), None);
    let answer = drive.receive(&reply_with(&[0xB4, 0x13, 0, 0, 0x00, 0x00, 0xC0, 0x3F]), at(3));
    assert_eq!(answer, Received::Reply(Reported::Indicator(0x13, 1.5)));
}

#[test]
fn indicators_are_polled_independently_of_fault_questions() {
    let cases: [(f64, &[usize]); 3] = [(1.0, &[22, 22]), (1e-300, &[1, 1]), (0.0, &[])];
    for (hz, expected) in cases {
        let mut settings = arm().settings;
        settings.safety.fault_poll_hz = 0.0;
        settings.cycle.indicator_hz = hz;
        let mut robot = Robot::new(settings, 1);
        robot.steps(1200);
        let finite = |values: &[f32]| values.iter().filter(|value| value.is_finite()).count();
        let known = robot.state().indicators().iter().map(|of| finite(&of.values)).collect::<Vec<_>>();
        assert_eq!(known, expected, "{hz} Hz");
    }
}

#[test]
fn mismatched_motor_is_named_even_when_silent() {
    let mut robot = Robot::new(arm().settings, 1);
    robot.cycle.mark_mismatch(1);
    robot.disturb("elbow off");
    robot.steps(300);
    assert_eq!(robot.mode(1), MotorMode::Offline);
    let mut flags = |joint: usize| robot.joint(joint).flags & motord_shared::message::JOINT_MISMATCH;
    assert!(flags(1) != 0 && flags(0) == 0, "the state tells it");
    robot.claim().expect("the group is free");
    robot.follow(&setpoints(SetpointMode::Torque, 0.0));
    assert_eq!(robot.operate(Operation::Enable).err(), Some(Refusal::Mismatch));
}

#[test]
fn clients_and_wire_name_indicators_alike() {
    let of_clients = Indicator::ALL.iter().map(|row| (row.code(), row.name(), row.unit()));
    assert!(of_clients.eq(INDICATORS.iter().map(|row| (row.id.into(), row.name, row.unit))));
}
