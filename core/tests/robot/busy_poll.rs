//! The sleep for replies and busy polling, on virtual time.

use motord_bus::Duration;
use motord_core::cycle::Polled;
use motord_harness::robot;
use motord_harness::robot::{Meaning, Robot};
use motord_shared::MotorMode;

const CYCLES: u32 = 1000;

/// Returns a robot without fault requests, and the number of sleeps and waits in [`CYCLES`] cycles.
fn waits(busy_poll: Duration, reading: Duration, disturbance: Option<&str>) -> (Robot, u32) {
    let mut settings = robot::three_motors();
    settings.cycle.busy_poll = busy_poll;
    settings.safety.fault_poll_hz = 0.0;
    let mut robot = Robot::new(settings, 1);
    robot.clock.reading.set(reading);
    robot.steps(100);
    disturbance.into_iter().for_each(|line| robot.disturb(line));
    robot.clock.waits.set(0);
    robot.steps(CYCLES as usize);
    let waits = robot.clock.waits.get();
    (robot, waits)
}

#[test]
fn busy_polling_finds_every_reply_after_one_wait() {
    let (mut robot, waits) = waits(Duration::from_micros(50), Duration::from_micros(1), None);
    assert_eq!(waits, 2 * CYCLES, "the sleep until the tick, and no second wait");
    assert!((0..3).all(|joint| robot.joint(joint).missed == 0 && robot.joint(joint).age_cycles == 0));
}

#[test]
fn polling_ends_at_its_bound_and_is_counted() {
    let mut settings = robot::three_motors();
    settings.cycle.busy_poll = Duration::from_micros(30);
    settings.safety.fault_poll_hz = 0.0;
    let mut robot = Robot::new(settings, 1);
    robot.clock.reading.set(Duration::from_micros(1));
    robot.steps(1000);
    let found = (0..CYCLES).map(|_| polled(&mut robot));
    let is_incomplete = found.filter(|polled| polled.is_incomplete || polled.reads == 0).count();
    assert!(is_incomplete < 10, "replies come when they came before: {is_incomplete}");
    robot.disturb("thigh off");
    let Polled { time, reads, is_incomplete } = polled(&mut robot);
    // The limit may be exceeded by one reading of the clock, and a few readings precede it.
    let bound = Duration::from_micros(30)..Duration::from_micros(40);
    assert!(is_incomplete && bound.contains(&time), "{time:?}");
    assert!((2..40).contains(&reads), "a read of one bus at each step of the clock: {reads}");
}

#[test]
fn states_are_on_time_despite_late_wakeups() {
    let published_after_replies = |late: Duration| {
        let mut settings = robot::three_motors();
        settings.safety.fault_poll_hz = 0.0;
        let mut robot = Robot::new(settings, 1);
        robot.clock.reading.set(Duration::from_nanos(100));
        robot.clock.always_late.set(late);
        robot.steps(CYCLES as usize);
        robot.clock.waits.set(0);
        robot.steps(CYCLES as usize);
        assert_eq!(robot.clock.waits.get(), 2 * CYCLES, "no second wait for replies");
        let state = robot.state();
        let replied = (0..3).map(|joint| robot.joint(joint).receive_ns).max().expect("three joints");
        Duration::from_nanos(state.publish_ns - replied)
    };
    let [exact, late] = [Duration::ZERO, Duration::from_micros(25)].map(published_after_replies);
    assert!(
        late < exact + Duration::from_micros(5),
        "{late:?} after the last reply, without lateness {exact:?}"
    );
}

#[test]
fn cycles_start_on_tick_despite_late_wakeups() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.clock.reading.set(Duration::from_nanos(100));
    robot.clock.always_late.set(Duration::from_micros(25));
    robot.steps(CYCLES as usize);
    for _ in 0..CYCLES {
        robot.steps(1);
        let late = Duration::from_nanos(robot.state().wake_latency_ns);
        assert!(late < Duration::from_micros(1), "{late:?} after the tick");
    }
}

/// An offline motor is requested ten times a second, and only then its reply is awaited.
#[test]
fn absent_motor_delays_states_once_per_hundred_cycles() {
    let mut robot = Robot::new(robot::three_motors(), 1);
    robot.disturb("thigh off");
    robot.steps(500);
    robot.take_sent();
    assert_eq!(robot.mode(1), MotorMode::Offline);
    let mut delayed = 0;
    for _ in 0..CYCLES {
        robot.step();
        let replied = [0, 2].map(|joint| robot.joint(joint).receive_ns).into_iter().max();
        let published = robot.state().publish_ns - replied.expect("two joints");
        delayed += u32::from(published > 50_000);
    }
    assert!((9..=11).contains(&delayed), "{delayed}");
    let questions =
        robot.take_sent().iter().filter(|sent| sent.id == 1 && sent.meaning == Meaning::GetFault).count();
    assert!((9..=11).contains(&questions), "the others are asked for their faults: {questions}");
}

/// Three motors on one bus, at rest and moving.
#[test]
fn each_motor_is_asked_for_faults_at_rate() {
    for hz in [1.0, 10.0, 40.0] {
        let mut settings = robot::three_motors();
        settings.safety.fault_poll_hz = hz;
        let mut robot = Robot::new(settings, 1);
        let joints = robot.activate();
        robot.take_sent();
        (0..CYCLES).for_each(|_| robot.follow(&joints));
        let sent = robot.take_sent();
        for id in 1..=3 {
            let asked = sent.iter().filter(|sent| sent.id == id && sent.meaning == Meaning::GetFault).count();
            // The next cycle after the interval asks.
            let least = f64::from(CYCLES) / (f64::from(CYCLES) / hz + 1.0) - 1.0;
            assert!((least..=hz + 1.0).contains(&f64::from(asked as u32)), "motor {id} at {hz} Hz: {asked}");
        }
    }
}

/// Returns the polling of the next cycle.
fn polled(robot: &mut Robot) -> Polled {
    robot.cycle_only();
    robot.client.record().expect("one for each cycle").polled
}

#[test]
fn motor_that_is_off_is_polled_when_asked() {
    let (mut robot, _) = waits(Duration::from_micros(30), Duration::from_micros(1), Some("thigh off"));
    let polls: Vec<_> = (0..CYCLES).map(|_| polled(&mut robot)).collect();
    let is_incomplete = polls.iter().filter(|polled| polled.is_incomplete).count();
    assert!((9..=11).contains(&is_incomplete), "asked ten times: {is_incomplete}");
    assert!(polls.iter().all(|polled| polled.reads > 0));
}

/// Three of four replies arrive much later than the end of the polling for the fourth.
#[test]
fn two_fruitless_polls_skip_the_next() {
    let (mut robot, _) = waits(Duration::from_micros(30), Duration::from_micros(1), None);
    let mut reads = 0;
    for cycle in 0..CYCLES {
        match cycle % 4 {
            0 => robot.disturb("knee ok"),
            1 => robot.disturb("knee delayed 250us"),
            _ => {}
        }
        reads += u32::from(polled(&mut robot).reads > 0);
    }
    assert!((CYCLES * 3 / 4 - 10..=CYCLES * 3 / 4 + 10).contains(&reads), "{reads}");
}

#[test]
fn polling_an_absent_motor_spares_other_replies() {
    for reading in [Duration::from_micros(1), Duration::ZERO] {
        let (mut robot, _) = waits(Duration::from_micros(50), reading, Some("thigh off"));
        assert_eq!([0, 2].map(|joint| robot.joint(joint).missed), [0; 2], "a reading takes {reading:?}");
        assert!(robot.state().overruns == 0);
    }
}
