//! Another sender commands a motor.

use motord_core::control::Event;
use motord_core::stopper::BusFrames;
use motord_harness::robot::{self, Robot};
use motord_settings::settings::Settings;
use motord_shared::{Cause, Operation, Phase, Refusal};

/// The heartbeat of an ODrive with node 0: `cansend vcan0 001#0000000001000000`.
const HEARTBEAT: &[u8; 8] = &[0, 0, 0, 0, 1, 0, 0, 0];

/// A stop frame (MIT document 1.2).
const STOP: &[u8; 8] = &[0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFD];

/// Sends one frame to the hip every 100 ms.
fn foreign_seconds(robot: &mut Robot, seconds: u32, payload: &[u8]) {
    for _ in 0..10 * seconds {
        robot.deliver_frame(0, 0x001, payload);
        robot.steps(100);
    }
}

#[test]
fn foreign_commands_are_reported_with_their_id() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(100);
    robot.take_events();
    foreign_seconds(&mut robot, 2, HEARTBEAT);
    assert_eq!(robot.take_events(), [Event::Foreign { motor: 0, id: 1, frames: 5 }]);
    let counts = [0, 1, 2].map(|joint| robot.joint(joint).foreign_commands);
    assert_eq!(counts, [20, 0, 0], "by motor");
}

/// A device that sends once a second is no master, but the log names it. Single frames of a tool
/// are not named.
#[test]
fn sender_once_a_second_is_named_only() {
    for (payload, frames, reported) in [(HEARTBEAT, 3, 0), (HEARTBEAT, 7, 1), (STOP, 7, 1)] {
        let mut robot = Robot::new(robot::three_motors(), 1);
        robot.steps(3500);
        let joints = robot.activate();
        robot.take_events();
        for _ in 0..frames {
            robot.deliver_frame(0, 0x001, payload);
            (0..1000).for_each(|_| robot.follow(&joints));
        }
        assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
        let events = robot.take_events();
        let named = events.iter().filter(|event| matches!(event, Event::Foreign { motor: 0, id: 1, .. }));
        assert_eq!(named.count(), reported, "{frames} frames: {events:?}");
    }
}

#[test]
fn group_with_foreign_master_is_not_enabled() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(100);
    robot.claim().unwrap();
    let joints = robot.hold(0.0, 1.0);
    for _ in 0..4 {
        robot.deliver_frame(0, 0x001, HEARTBEAT);
        robot.follow(&joints);
    }
    assert_eq!(robot.operate(Operation::Enable).unwrap_err(), Refusal::ForeignMaster);
}

/// Returns whether 5 frames of another master stop the active group of `settings`.
fn stops(settings: Settings) -> bool {
    let mut robot = Robot::new(settings, 1);
    let joints = robot.activate();
    for frame in 0..5 {
        assert_eq!(robot.phase(), Phase::Active, "{frame}");
        robot.deliver_frame(0, 0x001, HEARTBEAT);
        robot.follow(&joints);
    }
    robot.follow(&joints);
    Cause::try_from(robot.state().groups[0].cause) == Ok(Cause::ForeignMaster)
}

#[test]
fn foreign_master_stops_group_by_default() {
    assert!(stops(robot::three_motors()));
}

#[test]
fn setting_lets_group_run_beside_foreign_master() {
    let mut settings = robot::three_motors();
    settings.safety.stop_on_foreign_master = false;
    assert!(!stops(settings));
}

/// Some adapters return the frames that they send, in the same cycle or in the next one.
#[test]
fn echoes_of_own_frames_are_no_foreign_master() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let joints = robot.activate();
    robot.take_events();
    robot.take_sent();
    for _ in 0..2000 {
        robot.follow(&joints);
        for sent in robot.take_sent() {
            robot.deliver_frame(sent.bus, sent.id, &sent.bytes);
        }
    }
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
    assert_eq!([0, 1, 2].map(|joint| robot.joint(joint).foreign_commands), [0; 3]);
}

/// A person tries an excluded motor with the vendor's tool.
#[test]
fn excluded_motor_of_foreign_master_stops_no_group() {
    let mut settings = robot::three_motors();
    settings.motors[0].may_be_excluded = true;
    settings.motors[0].excluded = true;
    let mut robot = Robot::new(settings, 1);
    let joints = robot.activate();
    for _ in 0..50 {
        robot.deliver_frame(0, 0x001, HEARTBEAT);
        robot.follow(&joints);
    }
    assert_eq!((robot.phase(), robot.joint(0).foreign_commands), (Phase::Active, 50));
}

/// A person replays the recorded frames of another robot onto the bus.
#[test]
fn replayed_log_is_a_foreign_master() {
    let mut other = Robot::new(robot::three_motors(), 1);
    let joints = other.activate();
    other.take_sent();
    (0..10).for_each(|_| other.follow(&joints));
    let log = other.take_sent();
    let mut robot = Robot::new(robot::three_motors(), 1);
    let other_hold = robot.hold(20.0, 1.0);
    robot.activate();
    for sent in log {
        robot.deliver_frame(sent.bus, sent.id, &sent.bytes);
        robot.follow(&other_hold);
    }
    assert_eq!(robot.cause(), Some(Cause::ForeignMaster));
}

/// A second daemon sends stop frames to motors that it has not started.
#[test]
fn stops_of_second_daemon_are_a_foreign_master() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(3500);
    let joints = robot.activate();
    let mut cycles = 0;
    while robot.phase() == Phase::Active && cycles < 500 {
        robot.deliver_frame(0, 0x001, STOP);
        robot.follow(&joints);
        cycles += 1;
    }
    assert_eq!(robot.cause(), Some(Cause::ForeignMaster));
    assert!((200..220).contains(&cycles), "{cycles}");
}

/// A second daemon that only looks for its motors sends a stop frame every 100 ms.
#[test]
fn rare_stops_of_second_daemon_stop_group() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(3500);
    let joints = robot.activate();
    for cycle in 0..400 {
        if cycle % 100 == 0 {
            robot.deliver_frame(0, 0x001, STOP);
        }
        robot.follow(&joints);
    }
    assert_eq!(robot.cause(), Some(Cause::ForeignMaster));
}

/// A cycle of 10 Hz reads the frames of a second daemon every 100 ms.
#[test]
fn slow_cycle_reports_second_daemon() {
    let text = "[cycle]\nrate-hz = 10\n[safety]\nsetpoint-timeout-ms = 500\ndeadman-ms = 1000\n\
                [[bus]]\nname = \"can\"\ntype = \"simulated\"\n";
    let mut robot = Robot::new(robot::settings(&(text.to_owned() + &robot::motor(1, "hip", "can", ""))), 1);
    let damp = BusFrames::of(&robot.settings, 0).damp[0][0];
    robot.steps(40);
    robot.take_events();
    for _ in 0..4 {
        robot.deliver_frame(0, 0x001, damp.payload());
        robot.steps(1);
    }
    let events = robot.take_events();
    assert!(events.iter().any(|event| matches!(event, Event::Foreign { motor: 0, id: 1, .. })), "{events:?}");
}

/// Goal: short bursts of a switch add up to no foreign master. Method: a burst of 10 ms four times
/// a second.
#[test]
fn bursts_of_a_switch_do_not_add_up() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(3500);
    let joints = robot.activate();
    for cycle in 0..2000 {
        if cycle % 250 < 10 {
            robot.deliver_frame(0, 0x001, STOP);
        }
        robot.follow(&joints);
    }
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
}

/// Goal: no frame of a switch is a foreign master. Method: the switch of a daemon that died before
/// this one started damps for 2 s; the frames of another one arrive together after a freeze.
#[test]
fn frames_of_a_switch_are_no_foreign_master() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let damp = BusFrames::of(&robot.settings, 0).damp[0][0];
    let damp: &[u8; 8] = damp.payload().first_chunk().expect("it has 8 bytes");
    for round in 0..203 {
        robot.deliver_frame(0, 0x001, if round < 200 { damp } else { STOP });
        robot.steps(10);
    }
    robot.steps(2000);
    let joints = robot.activate();
    (0..200).for_each(|_| robot.deliver_frame(0, 0x001, damp));
    (0..1000).for_each(|_| robot.follow(&joints));
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
    let events = robot.take_events();
    assert!(!events.iter().any(|event| matches!(event, Event::Foreign { .. })), "{events:?}");
}

/// The dead man's switch sends such frames while this process is frozen.
#[test]
fn own_safe_frames_are_no_foreign_master() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(100);
    robot.take_events();
    foreign_seconds(&mut robot, 2, STOP);
    assert_eq!(robot.take_events(), []);
}
