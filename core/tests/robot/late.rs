//! Motors whose answers are constantly late, so that each arrives at the usual time after a later
//! request.

use crate::faults_bus::stopped_within;
use motord_core::control::Event;
use motord_harness::robot::{self, Robot};
use motord_shared::{Cause, MotorMode, Operation, Phase, Refusal, message};

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
