//! Another sender commands a motor.

use motord_core::control::Event;
use motord_harness::robot::{self, Robot};
use motord_shared::{Cause, Operation, Phase, Refusal};

/// The heartbeat of an ODrive with node 0: `cansend vcan0 001#0000000001000000`.
const HEARTBEAT: &[u8; 8] = &[0, 0, 0, 0, 1, 0, 0, 0];

/// Sends one frame to the hip every 100 ms.
fn foreign_seconds(robot: &mut Robot, seconds: u32, payload: &[u8]) {
    for _ in 0..10 * seconds {
        robot.hear(0, 0x001, payload);
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

#[test]
fn group_with_foreign_master_is_not_enabled() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(100);
    robot.claim().unwrap();
    let joints = robot.hold(0.0, 1.0);
    for _ in 0..4 {
        robot.hear(0, 0x001, HEARTBEAT);
        robot.follow(&joints);
    }
    assert_eq!(robot.operate(Operation::Enable).unwrap_err(), Refusal::ForeignMaster);
}

#[test]
fn foreign_master_stops_group_by_setting() {
    for stops in [true, false] {
        let mut settings = robot::three_motors();
        settings.safety.stop_on_foreign_master = stops;
        let mut robot = Robot::new(settings, 1);
        let joints = robot.activate();
        for frame in 0..5 {
            assert_eq!(robot.phase(), Phase::Active, "{frame}");
            robot.hear(0, 0x001, HEARTBEAT);
            robot.follow(&joints);
        }
        robot.follow(&joints);
        let cause = robot.state().groups[0].cause;
        assert_eq!(Cause::try_from(cause) == Ok(Cause::ForeignMaster), stops, "{cause}");
    }
}

/// The dead man's switch sends such frames while this process is frozen.
#[test]
fn own_safe_frames_are_no_foreign_master() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.steps(100);
    robot.take_events();
    foreign_seconds(&mut robot, 2, &[0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFD]);
    assert_eq!(robot.take_events(), []);
}
