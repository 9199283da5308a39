//! The fault catalogue, part C: what the clock and the scheduler do to the cycle. `docs/faults.md` tells which item each
//! test holds.

mod robot;

use motord_bus::{Duration, Instant};
use motord_shared::{Cause, Phase};
use robot::Robot;

#[test]
fn a_cycle_that_is_a_little_late_skips_and_goes_on() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let joints = robot.activate();
    for _ in 0..100 {
        robot.send(&joints);
        robot.take_sent();
        robot.oversleep(Duration::from_micros(2_300));
        robot.step();
        assert_eq!((robot.phase(), robot.take_sent().len() <= 4), (Phase::Active, true), "no burst");
    }
    assert_eq!(robot.state().overruns, 200);
}

#[test]
fn a_daemon_that_slept_half_a_second_wakes_into_a_stop() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let mut joints = robot.activate();
    joints.iter_mut().for_each(|joint| joint.torque = 3.0);
    // The owner was alive meanwhile, and its newest message waits.
    robot.send(&joints);
    robot.take_sent();
    robot.oversleep(Duration::from_millis(500));
    robot.step();
    assert_eq!((robot.phase(), robot.cause()), (Phase::Damping, Some(Cause::TimeBase)));
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()), "from the first frame on");
    assert_eq!(robot.state().overruns, 500);
}

#[test]
fn a_clock_that_runs_backwards_changes_no_command_and_stops_nothing() {
    for back in [Duration::from_nanos(1), Duration::from_micros(100), Duration::from_millis(1)] {
        let mut robot = Robot::new(robot::three_motors(), 1);
        let joints = robot.activate();
        for _ in 0..100 {
            robot.turn_clock_back(back);
            robot.follow(&joints);
        }
        assert_eq!(robot.phase(), Phase::Active, "{back:?}");
        assert!(robot.state().cycle > 100);
    }
}

/// Goal: nothing breaks where counters and times are near their ends.
/// Method: a robot whose clock began 292 years ago, where a signed count of nanoseconds ends.
#[test]
fn a_clock_near_its_end_is_a_clock_like_any_other() {
    let start = Instant::from_nanos(i64::MAX as u64 - 1_000_000_000);
    let mut robot = Robot::begun_at(start, robot::three_motors(), 1, |_, _| {});
    let joints = robot.activate();
    for _ in 0..2000 {
        robot.follow(&joints);
    }
    assert!(robot.now().as_nanos() > i64::MAX as u64);
    assert_eq!(robot.phase(), Phase::Active);
}
