//! Motors that take turns on their bus, on virtual time: on a serial line, and on CAN.

use crate::faults_bus::stopped_within;
use motord_core::control::Event;
use motord_harness::robot::{self, Meaning, Robot};
use motord_shared::{Cause, JointSetpoint, MotorMode, Operation, Phase, Refusal, SetpointMode, message};

/// Returns two native motors on a line at 200 Hz and three MIT motors at 1 kHz, in two groups.
fn arm_and_leg() -> Robot {
    let mut text = String::from("[safety]\nsetpoint-timeout-ms = 20\n");
    text += "[[bus]]\nname = \"arm\"\ntype = \"serial\"\ndevice = \"/dev/ttyUSB0\"\nevery = 5\n";
    text += "[[bus]]\nname = \"leg\"\ntype = \"simulated\"\n";
    for (id, name) in [(1, "shoulder"), (2, "elbow")] {
        text += &robot::motor(id, name, "arm", "host-id = 0").replace("\"mit\"", "\"gim\"");
    }
    text = text.replacen("host-id = 0\n", "host-id = 10\n", 1).replacen("host-id = 0\n", "host-id = 11\n", 1);
    for (id, name) in [(1, "hip"), (2, "thigh"), (3, "knee")] {
        text += &robot::motor(id, name, "leg", "");
    }
    text += "[[group]]\nname = \"arm\"\njoints = [\"shoulder\", \"elbow\"]\n";
    text += "[[group]]\nname = \"leg\"\njoints = [\"hip\", \"thigh\", \"knee\"]\n";
    Robot::new(robot::settings(&text), 1)
}

fn torque(value: f32) -> Vec<JointSetpoint> {
    vec![JointSetpoint { mode: SetpointMode::Torque.code(), torque: value, ..Default::default() }; 2]
}

fn activate(robot: &mut Robot, joints: &[JointSetpoint]) {
    robot.steps(500);
    assert_eq!([robot.mode(0), robot.mode(1)], [MotorMode::Idle; 2], "{:?}", robot.state().joints());
    robot.claim().expect("the group is free");
    robot.follow(joints);
    robot.operate(Operation::Enable).expect("all is well");
    for _ in 0..300 {
        robot.follow(joints);
    }
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
}

#[test]
fn line_motor_gets_one_command_per_five_cycles() {
    let mut robot = arm_and_leg();
    let joints = torque(0.2);
    activate(&mut robot, &joints);
    let missed = [0, 1].map(|joint| robot.joint(joint).missed);
    robot.take_sent();
    for _ in 0..1000 {
        robot.follow(&joints);
        let ages = [0, 1].map(|joint| robot.joint(joint).age_cycles);
        assert_eq!(ages, [0, 0], "a joint is not older for waiting");
    }
    let sent: Vec<_> = robot.take_sent().into_iter().filter(|sent| sent.bus == 0).collect();
    for id in [1, 2] {
        let commands = sent.iter().filter(|sent| sent.id == id && sent.bytes[0] == 0x93);
        let times: Vec<_> = commands.map(|sent| sent.ready).collect();
        assert!((199..=201).contains(&times.len()), "{}", times.len());
        assert!(times.windows(2).all(|pair| pair[1].since(pair[0]) == 5 * robot::PERIOD));
        let questions = sent.iter().filter(|sent| sent.id == id && sent.bytes[0] == 0xB2).count();
        assert!((9..=11).contains(&questions), "asked {questions} times for its faults in a second");
    }
    assert_eq!([0, 1].map(|joint| robot.joint(joint).missed), missed);
    let line = robot.bus(0);
    assert_eq!((line.dropped, line.unexpected_id, line.malformed), (0, 0, 0), "{line:?}");
    assert!(robot.joint(0).position > 0.1, "{}", robot.joint(0).position);
}

#[test]
fn line_state_is_new_once_in_five_cycles() {
    let mut robot = arm_and_leg();
    let joints = torque(0.0);
    activate(&mut robot, &joints);
    let mut new = 0;
    for _ in 0..100 {
        robot.follow(&joints);
        new += u32::from(robot.joint(0).flags & motord_shared::message::JOINT_FRESH != 0);
    }
    assert_eq!(new, 20);
}

/// The state is read in the cycle in which the next turn of its motor begins.
#[test]
fn state_at_end_of_turn_is_new() {
    let line = "[[bus]]\nname = \"arm\"\ntype = \"serial\"\ndevice = \"/dev/ttyUSB0\"\nevery = 2\n";
    let motor = robot::motor(1, "elbow", "arm", "host-id = 10").replace("\"mit\"", "\"gim\"");
    let mut robot = Robot::new(robot::settings(&format!("{line}{motor}")), 1);
    robot.disturb("elbow delayed 1300us");
    robot.steps(500);
    let (mut fresh, mut before) = (0, robot.joint(0).receive_ns);
    for _ in 0..200 {
        robot.step();
        let joint = robot.joint(0);
        let is_new = joint.flags & motord_shared::message::JOINT_FRESH != 0;
        assert_eq!(is_new, joint.receive_ns != before, "{joint:?}");
        fresh += u32::from(is_new);
        before = joint.receive_ns;
    }
    assert!(fresh > 50, "{fresh}");
}

#[test]
fn cycle_never_waits_for_a_line() {
    let latencies = |fault: Option<&str>| {
        let mut robot = arm_and_leg();
        robot.steps(500);
        if let Some(fault) = fault {
            robot.disturb(fault);
        }
        robot.steps(20);
        let waits = robot.clock.waits.take();
        let before = robot.bus(1);
        let mut longest = 0;
        for _ in 0..1000 {
            let begun = robot.next();
            robot.step();
            longest = longest.max(robot.now().since(begun).as_nanos());
        }
        assert!(waits > 0);
        let joints: Vec<_> = (2..5).map(|joint| robot.joint(joint)).collect();
        let after = robot.bus(1);
        let missed: Vec<_> = joints.iter().map(|joint| (joint.missed, joint.late)).collect();
        (missed, after.sent - before.sent, robot.clock.waits.get(), longest)
    };
    let sound = latencies(None);
    assert_eq!(sound.0, [(0, 0); 3]);
    for fault in ["arm gone", "arm tx-full", "shoulder off", "shoulder slow 10ms", "arm down"] {
        assert_eq!(latencies(Some(fault)), sound, "{fault}");
    }
}

#[test]
fn line_motor_is_lost_after_ten_silent_turns() {
    let mut robot = arm_and_leg();
    let joints = torque(0.0);
    activate(&mut robot, &joints);
    robot.disturb("elbow off");
    let mut cycles = 0;
    while robot.phase() == Phase::Active {
        robot.follow(&joints);
        cycles += 1;
        assert!(cycles < 100);
    }
    assert_eq!((robot.cause(), robot.group().cause_joint), (Some(Cause::MotorLost), 1));
    assert!((45..=55).contains(&cycles), "{cycles} cycles");
}

#[test]
fn reply_within_its_turn_is_not_late() {
    let mut robot = arm_and_leg();
    let joints = torque(0.0);
    activate(&mut robot, &joints);
    robot.disturb("elbow delayed 1200us");
    let (missed, late) = (robot.joint(1).missed, robot.joint(1).late);
    for _ in 0..500 {
        robot.follow(&joints);
    }
    assert_eq!((robot.joint(1).missed, robot.joint(1).late), (missed, late));
    assert_eq!(robot.phase(), Phase::Active);
}

/// 100 N·m/s at 5 ms a turn.
#[test]
fn a_slew_limit_counts_time_and_not_cycles() {
    let mut robot = arm_and_leg();
    let joints = torque(0.0);
    activate(&mut robot, &joints);
    robot.take_sent();
    let joints = torque(4.0);
    for _ in 0..20 {
        robot.follow(&joints);
    }
    let torques: Vec<_> = robot
        .take_sent()
        .iter()
        .filter(|sent| sent.bus == 0 && sent.id == 1 && sent.bytes[0] == 0x93)
        .map(|sent| f32::from_le_bytes([sent.bytes[1], sent.bytes[2], sent.bytes[3], sent.bytes[4]]))
        .collect();
    let steps: Vec<_> = torques.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(!steps.is_empty() && steps.iter().all(|step| (step - 0.5).abs() < 0.01), "{torques:?}");
}

#[test]
fn stopped_line_receives_stops_and_reports_position() {
    let mut robot = arm_and_leg();
    robot.steps(500);
    robot.take_sent();
    robot.steps(1000);
    let sent = robot.take_sent_to(1);
    let first = |sent: &robot::Sent| sent.bytes[0];
    let line: Vec<_> = sent.iter().filter(|sent| sent.bus == 0).map(first).collect();
    assert!(line.iter().all(|code| [0x92, 0xB4, 0xB2].contains(code)), "{line:02X?}");
    assert!(line.iter().filter(|code| **code == 0x92).count() >= 18, "a stop in every tenth turn");
    assert!(sent.iter().filter(|sent| sent.bus == 1).all(|sent| sent.meaning != Meaning::Start));
}

/// Four motors on CAN in turns of two cycles.
#[test]
fn motors_take_turns_on_can_too() {
    let mut text = String::from(
        "[safety]\nsetpoint-timeout-ms = 20\n[[bus]]\nname = \"can\"\ntype = \"simulated\"\nevery = 2\n",
    );
    for id in 1..=4 {
        text += &robot::motor(id, &format!("joint-{id}"), "can", "");
    }
    let mut robot = Robot::new(robot::settings(&text), 1);
    let joints = robot.activate();
    for _ in 0..200 {
        robot.follow(&joints);
        let asked: Vec<_> = robot
            .take_sent()
            .iter()
            .filter(|sent| sent.meaning != Meaning::GetFault)
            .map(|sent| sent.id)
            .collect();
        assert!([vec![1, 2], vec![3, 4]].contains(&asked), "{asked:?}");
    }
    assert_eq!(robot.state().joints().iter().map(|joint| joint.missed).sum::<u32>(), 0);
}

/// Goal: the velocity of a motor from before its silence is not used again: it may have been
/// switched off since.
#[test]
fn returning_motor_forgets_its_old_velocity() {
    let mut robot = arm_and_leg();
    let turning = JointSetpoint { mode: SetpointMode::Speed.code(), velocity: 3.0, ..Default::default() };
    activate(&mut robot, &[turning; 2]);
    (0..300).for_each(|_| robot.follow(&[turning; 2]));
    assert!(robot.joint(0).velocity > 2.0, "{}", robot.joint(0).velocity);
    robot.disturb("shoulder power-off");
    robot.steps(1000);
    assert_eq!(robot.mode(0), MotorMode::Offline);
    robot.disturb("shoulder ok");
    for _ in 0..3000 {
        robot.step();
        if robot.mode(0) != MotorMode::Offline {
            break;
        }
    }
    assert_eq!(robot.mode(0), MotorMode::Idle);
    assert!(robot.joint(0).velocity.abs() < 0.1, "{}", robot.joint(0).velocity);
}

/// Goal: a motor that boots is back some turns after its first answer, which only shows its
/// presence. From then on it gets a request in every turn, and no longer ten times a second.
#[test]
fn returning_native_motor_is_asked_for_everything() {
    for phase in 0..5 {
        let mut robot = arm_and_leg();
        robot.steps(500);
        robot.disturb("shoulder power-off");
        robot.steps(1000 + 23 * phase);
        assert_eq!(robot.mode(0), MotorMode::Offline);
        robot.disturb("shoulder ok");
        // It boots for 300 ms, and gets a request at most 105 ms later.
        robot.steps(300 + 105 + 100);
        assert_eq!(robot.mode(0), MotorMode::Idle, "after {phase}");
    }
}

/// Goal: damage that the command and the numbers of a reply do not reveal reaches no state, as far
/// as physics reveals it.
#[test]
fn impossible_speed_is_in_no_state() {
    let mut robot = arm_and_leg();
    robot.steps(500);
    let [a, b, c, d] = 1e21_f32.to_le_bytes();
    for _ in 0..200 {
        // Indicator 0x14 (GIM document, table 10), which is requested in one of ten turns.
        robot.deliver_frame(0, 10, &[0xB4, 0x14, 0, 0, a, b, c, d]);
        robot.step();
        let velocity = robot.joint(0).velocity;
        assert!(velocity.abs() < 1.0, "{velocity}");
    }
}

/// The drive's decoder accepts it, and checks only its form.
#[test]
fn rejected_state_is_in_no_torque() {
    let mut robot = arm_and_leg();
    let stiff = vec![JointSetpoint { position: 0.05, kp: 60.0, kd: 1.0, ..Default::default() }; 2];
    activate(&mut robot, &stiff);
    robot.disturb("shoulder off");
    let commands = |robot: &mut Robot| -> Vec<_> {
        let sent = robot.take_sent_to(1);
        sent.into_iter().filter(|sent| sent.bus == 0 && sent.bytes[0] == 0x93).collect()
    };
    robot.take_sent();
    while commands(&mut robot).is_empty() {
        robot.follow(&stiff);
    }
    // 0xA000: a position of 3.125 rad (GIM document, 3.2.7).
    robot.deliver_frame(0, 10, &[0x93, 0, 25, 0x00, 0xA0, 0x80, 0x08, 0x00]);
    (0..11).for_each(|_| robot.follow(&stiff));
    assert_eq!(robot.joint(0).implausible, 1);
    let torque = |sent: &robot::Sent| f32::from_le_bytes([1, 2, 3, 4].map(|byte| sent.bytes[byte])).abs();
    let torques: Vec<_> = commands(&mut robot).iter().map(torque).collect();
    assert!(torques.len() == 2 && torques.iter().all(|torque| *torque < 1.0), "{torques:?} at rest");
}

/// Goal: clients receive every indicator of table 10, from a line and from moving motors, about
/// once a second.
#[test]
fn native_indicators_are_known_after_a_second() {
    let mut robot = arm_and_leg();
    let joints = torque(0.0);
    activate(&mut robot, &joints);
    robot.take_sent();
    for _ in 0..1200 {
        robot.follow(&joints);
    }
    let state = robot.state();
    let joints_of: Vec<_> = state.indicators().iter().map(|indicators| indicators.joint).collect();
    assert_eq!(joints_of, [0, 1], "MIT motors have none");
    let values = state.indicators()[0].values;
    assert!(values.iter().all(|value| value.is_finite()), "{values:?}");
    assert!((values[0] - 48.0).abs() < 1.0, "bus voltage {} V", values[0]);
    assert!((values[0x13] - state.joints[0].position).abs() < 0.5, "shaft angle {} rad", values[0x13]);
    let asked = robot.take_sent_to(1).iter().filter(|sent| sent.bus == 0 && sent.bytes[0] == 0xB4).count();
    // 22 indicators, and 11 times the voltage of the supply.
    assert!((28..=40).contains(&asked), "asked {asked} times in 1.2 s");
    assert_eq!(robot.joint(0).missed, 0);
    robot.disturb("shoulder off");
    robot.steps(200);
    let values = robot.state().indicators()[0].values;
    assert!(values.iter().all(|value| value.is_nan()), "{values:?}");
}

// Motors whose answers are constantly late, so that each arrives at the usual time after a later
// request.

/// The shipped robot of three vendors at 300 Hz: 20 ms are six periods. `more` is for [safety].
fn mixed(more: &str) -> Robot {
    let text = include_str!("../../../config/mixed-simulated.toml");
    let text =
        text.replace("rate-hz = 1000", "rate-hz = 300").replace("[safety]\n", &format!("[safety]\n{more}\n"));
    Robot::new(robot::settings(&text), 3)
}

/// A motor of each vendor, and its name.
const VENDORS: [(usize, &str); 3] = [(0, "fl-hip"), (3, "fr-hip"), (6, "rl-hip")];

/// The age of the published state of a joint by the simulated clock, in cycles, from the position
/// of a joint that moves.
fn behind(robot: &mut Robot, joint: usize) -> (u32, bool) {
    let state = robot.joint(joint);
    (state.age_cycles, state.flags & message::JOINT_FRESH != 0)
}

/// Goal: no motor of any vendor is driven on by positions that are six cycles old. Method: the
/// issue's own fault, with and without questions for faults.
#[test]
fn late_answers_of_every_vendor_stop_the_group() {
    for more in ["", "fault-poll-hz = 0.0"] {
        for (joint, name) in VENDORS {
            let mut robot = mixed(more);
            let joints = robot.activate();
            robot.take_events();
            robot.disturb(&format!("{name} delayed 20ms"));
            let (cause, _) = stopped_within(&mut robot, &joints, 300);
            assert_eq!((cause, robot.group().cause_joint), (Cause::MotorLost, joint as u32), "{name} {more}");
            let events = robot.take_events();
            let late =
                |event: &Event| matches!(event, Event::Late { motor, turns: 6 | 7, .. } if *motor == joint);
            assert!(events.iter().any(late), "{name} {more}: {events:?}");
        }
    }
}

/// Goal: the true age is published, in cycles and as the time of the state, and the group cannot be
/// enabled.
#[test]
fn stopped_late_motor_reports_its_true_age() {
    for (joint, name) in VENDORS {
        let mut robot = mixed("");
        robot.steps(300);
        robot.disturb(&format!("{name} delayed 20ms"));
        robot.steps(300);
        assert_eq!(robot.mode(joint), MotorMode::Idle);
        for _ in 0..300 {
            robot.step();
            let (age, fresh) = behind(&mut robot, joint);
            assert!((6..=8).contains(&age) && !fresh, "{name}: age {age}, fresh {fresh}");
            let state = robot.joint(joint);
            let old = robot.now().as_nanos() - state.receive_ns;
            assert!((16_000_000..=30_000_000).contains(&old), "{name}: {old} ns");
            assert!(
                (20_000_000..=24_000_000).contains(&state.reply_latency_ns),
                "{name}: {}",
                state.reply_latency_ns
            );
        }
        robot.claim().unwrap();
        let joints = robot.hold(10.0, 1.0);
        robot.follow(&joints);
        assert_eq!(robot.operate(Operation::Enable).unwrap_err(), Refusal::StateStale);
        robot.disturb(&format!("{name} delayed 0ms"));
        robot.steps(600);
        assert_eq!(behind(&mut robot, joint), (0, true), "{name}");
        let events = robot.take_events();
        let late: Vec<_> = events.iter().filter(|event| matches!(event, Event::Late { .. })).collect();
        assert!(matches!(late[..], [Event::Late { .. }, Event::Late { turns: 0, .. }]), "{late:?}");
    }
}

/// Goal: lost replies are no late ones. Method: a tenth of the replies of three motors is lost for
/// a minute.
#[test]
fn random_loss_is_never_taken_for_lateness() {
    let mut robot = mixed("");
    let joints = robot.activate();
    VENDORS.iter().for_each(|(_, name)| robot.disturb(&format!("{name} intermittent 10%")));
    robot.take_events();
    robot.take_sent();
    for cycle in 0..18_000 {
        robot.follow(&joints);
        assert_eq!(robot.phase(), Phase::Active, "{cycle}: {:?}", robot.cause());
    }
    let late = |event: &Event| matches!(event, Event::Late { .. });
    assert!(!robot.take_events().iter().any(late));
    // At most four commands a second are left out to find that.
    let sent = robot.take_sent();
    for (joint, name) in VENDORS {
        let motor = &robot.settings.motors[joint];
        let (bus, id) = (motor.bus, u16::from(motor.id));
        let sent = sent.iter().filter(|sent| (sent.bus, sent.id) == (bus, id)).count();
        assert!(sent >= 18_000 - 4 * 60 - 1, "{name}: {sent}");
    }
}
