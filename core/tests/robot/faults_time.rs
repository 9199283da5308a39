//! The fault catalogue, part C: effects of the clock and the scheduler on the cycle.
//! `docs/faults.md` lists the item of each test.

use motord_bus::{Duration, Instant};
use motord_harness::robot;
use motord_harness::robot::Robot;
use motord_shared::{Cause, Phase};

#[test]
fn slightly_late_cycle_skips_and_continues() {
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

/// Goal: a robot with a computer that is too slow is stopped, and does not move at a fraction of
/// its rate.
/// Method: a fifth of the ticks may be missed. Every cycle begins 1.2 ms late, so that half of them
/// are missed.
#[test]
fn too_many_missed_ticks_stop_the_robot() {
    let mut settings = robot::three_motors();
    settings.cycle.max_missed_ticks = 0.2;
    let mut robot = Robot::new(settings, 1);
    let joints = robot.activate();
    let mut late = 0;
    while robot.phase() == Phase::Active {
        robot.oversleep(Duration::from_micros(1_200));
        robot.follow(&joints);
        late += 1;
    }
    assert_eq!(robot.cause(), Some(Cause::Overload));
    assert!((100..500).contains(&late), "after {late} cycles of 2 ms: a second's share, not a moment's");
}

#[test]
fn permitted_half_second_stall_is_no_overload() {
    let mut settings = robot::three_motors();
    settings.cycle.max_lateness = Duration::from_secs(1);
    settings.safety.setpoint_timeout = Duration::from_secs(1);
    let mut robot = Robot::new(settings, 1);
    let joints = robot.activate();
    robot.oversleep(Duration::from_millis(500));
    for _ in 0..2000 {
        robot.follow(&joints);
        assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
    }
}

#[test]
fn suspended_computer_resumes_into_a_stop() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let mut joints = robot.activate();
    joints.iter_mut().for_each(|joint| joint.torque = 3.0);
    robot.suspend(Duration::from_secs(60));
    robot.take_sent();
    robot.follow(&joints);
    assert_eq!((robot.phase(), robot.cause()), (Phase::Damping, Some(Cause::Suspended)));
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()), "from the first frame on");
}

/// The two clocks cannot be read at the same time: a delay between the readings reduces the
/// suspension for one cycle.
#[test]
fn delay_between_clock_readings_is_no_suspension() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.suspend(Duration::from_secs(60));
    let joints = robot.activate();
    for _ in 0..100 {
        robot.clock.suspended.set(Duration::from_secs(30));
        robot.follow(&joints);
        robot.clock.suspended.set(Duration::from_secs(60));
        robot.follow(&joints);
    }
    assert_eq!(robot.phase(), Phase::Active, "{:?}", robot.cause());
}

#[test]
fn daemon_asleep_half_a_second_resumes_stopped() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    let mut joints = robot.activate();
    joints.iter_mut().for_each(|joint| joint.torque = 3.0);
    // The owner was running meanwhile, and its newest message waits.
    robot.send(&joints);
    robot.take_sent();
    robot.oversleep(Duration::from_millis(500));
    robot.step();
    assert_eq!((robot.phase(), robot.cause()), (Phase::Damping, Some(Cause::TimeBase)));
    assert!(robot.take_sent().iter().all(|sent| sent.meaning.is_safe()), "from the first frame on");
    assert_eq!(robot.state().overruns, 500);
}

/// Goal: a resumed daemon whose motors were stopped by another process does not send its earlier
/// decisions to them.
/// Method: the daemon is frozen at every point of a cycle at which it reads the clock, and thus
/// before every bus.
#[test]
fn thawed_daemon_sends_no_old_decisions() {
    for reading in 0..12 {
        let mut robot = Robot::new(robot::quadruped(), 1);
        let mut joints = robot.activate();
        joints.iter_mut().for_each(|joint| joint.torque = 3.0);
        robot.follow(&joints);
        robot.take_sent();
        let thaws = robot.next() + Duration::from_millis(100);
        robot.clock.freeze.set(Some((reading, Duration::from_millis(101))));
        robot.steps(3);
        assert_eq!((robot.phase(), robot.clock.freeze.get()), (Phase::Damping, None), "at reading {reading}");
        let mut sent = robot.take_sent();
        sent.retain(|sent| sent.ready >= thaws);
        assert!(sent.len() >= 12 && sent.iter().all(|sent| sent.meaning.is_safe()), "at reading {reading}");
    }
}

/// Goal: a cycle that is interrupted while it sends awaits the replies to all frames that it sent.
/// Method: an interruption of 3 ms, which is not too long, at every point at which it reads the
/// clock.
#[test]
fn interrupted_send_misses_no_reply() {
    for reading in 0..12 {
        let mut robot = Robot::new(robot::quadruped(), 1);
        let joints = robot.activate();
        let missed = |robot: &mut Robot| (0..12).map(|joint| robot.joint(joint).missed).sum::<u32>();
        let before = missed(&mut robot);
        robot.clock.freeze.set(Some((reading, Duration::from_millis(3))));
        for _ in 0..20 {
            robot.follow(&joints);
        }
        assert_eq!((robot.phase(), missed(&mut robot) - before), (Phase::Active, 0), "at reading {reading}");
    }
}

#[test]
fn backward_clock_changes_no_command() {
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

/// Goal: the cycle works when counters and times are near their ends.
/// Method: a robot whose clock began 292 years ago, where a signed count of nanoseconds ends.
#[test]
fn clock_near_its_end_behaves_normally() {
    let start = Instant::from_nanos(i64::MAX as u64 - 1_000_000_000);
    let mut robot = Robot::begun_at(start, robot::three_motors(), 1, |_, _| {});
    let joints = robot.activate();
    for _ in 0..2000 {
        robot.follow(&joints);
    }
    assert!(robot.now().as_nanos() > i64::MAX as u64);
    assert_eq!(robot.phase(), Phase::Active);
}
