//! Number of reads of a cycle, and of frames that each requests.

use core::num::NonZero;
use motord_bus::{Bus, Content, Duration, Frame, FrameId, Inbox, Instant, Readiness, Sent};
use motord_core::cycle::Polled;
use motord_harness::robot::line::Wire;
use motord_harness::robot::{self, Meaning, Robot, Shared};
use motord_settings::settings::Settings;
use motord_shared::message::JOINT_FRESH;
use motord_shared::{Cause, MotorMode};
use motord_simulator::SharedBus;

/// The reads of a bus.
#[derive(Debug, Clone, Default)]
struct Reads {
    count: Shared<usize>,
    /// Number of arrivals that the last read requested.
    asked: Shared<usize>,
    /// Time of the last read.
    at: Shared<Instant>,
    /// An unexpected frame arrives after the next read.
    is_followed_by_another: Shared<bool>,
}

/// A bus whose reads are counted.
struct Counted {
    bus: SharedBus,
    reads: Reads,
}

impl Bus for Counted {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        self.bus.send(now, frames)
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        self.reads.count.set(self.reads.count.get() + 1);
        self.reads.asked.set(inbox.free());
        self.reads.at.set(now);
        self.bus.receive(now, inbox);
        if self.reads.is_followed_by_another.take() {
            let frame = Frame::new(FrameId::new(0x77).expect("eleven bits"), &[0; 8]).expect("eight bytes");
            self.bus.lock().deliver(now, Content::Frame(frame));
        }
    }

    fn readiness(&self) -> Readiness<'_> {
        self.bus.readiness()
    }
}

/// Returns a robot without fault requests, and the reads of its first bus.
fn counted(settings: Settings) -> (Robot, Reads) {
    let (robot, reads) = counted_by_bus(settings);
    (robot, reads[0].clone())
}

/// Returns a robot without fault requests, and the reads of each bus; `count` is that of all.
fn counted_by_bus(mut settings: Settings) -> (Robot, Vec<Reads>) {
    settings.safety.fault_poll_hz = 0.0;
    let simulated = Robot::new(settings.clone(), 1);
    let count = Shared::default();
    let reads: Vec<_> =
        simulated.buses.iter().map(|_| Reads { count: count.clone(), ..Reads::default() }).collect();
    let wires = simulated.buses.iter().zip(&reads).map(|(wire, reads)| {
        let Wire::Bus(bus) = wire else { unreachable!("the robot has no line") };
        Box::new(Counted { bus: bus.clone(), reads: reads.clone() }) as Box<dyn Bus>
    });
    let mut robot = Robot::on(wires.collect(), simulated.now(), settings);
    robot.buses = simulated.buses;
    robot.steps(100);
    (robot, reads)
}

/// Returns the number of joints with a state of the last cycle.
fn fresh(robot: &mut Robot) -> usize {
    let state = robot.state();
    state.joints().iter().filter(|joint| joint.flags & JOINT_FRESH != 0).count()
}

/// A read that finds no frame costs kernel time in every cycle, and late replies are rare.
#[test]
fn read_waits_for_awaited_replies_only() {
    let (mut robot, reads) = counted(robot::three_motors());
    assert_eq!(reads.asked.get(), 3);
    let reads_all_for = |robot: &mut Robot, cycles: u32, reason: &str| {
        for cycle in 0..cycles {
            robot.step();
            assert_eq!(reads.asked.get(), Inbox::CAPACITY, "{cycle} cycles after {reason}");
        }
        robot.step();
        assert_eq!(reads.asked.get(), 3, "{cycles} cycles after {reason}");
    };
    robot.deliver_frame(0, 0x101, &[1, 0x80, 0, 0x80, 0x08, 0]);
    reads_all_for(&mut robot, 51, "a second reply");
    robot.disturb("knee delayed 210us");
    robot.step();
    assert_eq!(reads.asked.get(), 1, "the others have answered");
    robot.disturb("knee ok");
    robot.disturb("thigh off");
    robot.step();
    robot.disturb("thigh ok");
    reads_all_for(&mut robot, 51, "a reply that did not come");
}

/// Returns the times from the read of the first bus to those of the others, µs, in a cycle that
/// wakes 30 µs before the last replies. The knee of the last bus answers later than the others by
/// `delay`.
fn after_the_first_read(delay: &str) -> [u64; 3] {
    let (mut robot, reads) = counted_by_bus(robot::quadruped());
    robot.disturb(&format!("rear-right-knee delayed {delay}"));
    robot.clock.reading.set(Duration::from_micros(1));
    robot.clock.always_late.set(Duration::from_micros(40));
    robot.steps(100);
    robot.clock.always_late.set(Duration::ZERO);
    reads[0].count.set(0);
    robot.step();
    assert_eq!((fresh(&mut robot), reads[0].count.get()), (12, 4), "each bus is read once");
    [1, 2, 3].map(|bus: usize| reads[bus].at.get().since(reads[0].at.get()).as_micros() as u64)
}

/// A cycle that wakes too soon for the last replies reads the other buses meanwhile.
#[test]
fn overdue_bus_is_read_while_awaiting_another() {
    // The last reply arrives 54 µs after those of the other buses.
    let [second, third, last] = after_the_first_read("210us");
    assert!(second <= third && third < 5 && last > 20, "{second}, {third}, {last}");
}

/// Replies may be slightly later than expected. After a read without a result, a wait and another
/// read follow.
#[test]
fn bus_is_not_read_at_typical_reply_time() {
    // The last reply arrives 19 µs after those of the other buses.
    let [second, third, last] = after_the_first_read("175us");
    assert!(second <= third && third <= last && last < 5, "{second}, {third}, {last}");
}

/// A reply to the command of an earlier cycle may arrive in any cycle.
#[test]
fn bus_with_turns_is_read_in_full() {
    let mut settings = robot::three_motors();
    settings.buses[0].every = NonZero::new(2).unwrap();
    let (mut robot, reads) = counted(settings);
    for _ in 0..100 {
        robot.step();
        assert_eq!(reads.asked.get(), Inbox::CAPACITY);
    }
}

/// Goal: a frame before an awaited reply does not delay the reply to another cycle, however late
/// the cycle wakes.
/// Method: before each check the bus was quiet for so long that a read requests only the replies.
#[test]
fn reply_behind_other_frames_is_read_in_time() {
    let (mut robot, reads) = counted(robot::three_motors());
    let joints = robot.activate();
    // Time from the beginning of a cycle to the sleep for its replies.
    let lateness = Shared::new(Duration::ZERO);
    let (late, next) = (robot.clock.late.clone(), lateness.clone());
    robot.cycle.on_begin(move |_| late.set(next.take()));
    let others: [(u16, &[u8]); 3] =
        [(0x102, &[2, 0x80, 0, 0x80, 0x08, 0]), (0x102, &[1, 2, 3]), (0x77, &[0; 8])];
    for (id, payload) in others {
        for _ in 0..100 {
            robot.follow(&joints);
        }
        assert!(reads.asked.get() <= 3, "the bus is quiet");
        robot.deliver_frame(0, id, payload);
        lateness.set(robot.settings.cycle.reply_deadline);
        robot.follow(&joints);
        assert_eq!(fresh(&mut robot), 3, "behind {payload:?} of {id:#x}");
    }
}

/// Goal: a late answer of a lost motor does not move the replies of the others to another cycle.
/// Method: it arrives after the bus has been quiet for long enough.
#[test]
fn late_answer_of_lost_motor_hides_nothing() {
    let mut settings = robot::three_motors();
    settings.motors[1].may_be_excluded = true;
    let (mut robot, _) = counted(settings);
    robot.disturb("thigh off");
    robot.steps(200);
    assert_eq!(robot.mode(1), MotorMode::Offline);
    for after in 50..100 {
        // From the first cycle with a new request to it.
        while robot.take_sent_to(2).is_empty() {
            robot.step();
        }
        robot.steps(after);
        robot.deliver_frame(0, 0x102, &[2, 0x80, 0, 0x80, 0x08, 0]);
        robot.step();
        let fresh = [0, 2].map(|joint| robot.joint(joint).flags & JOINT_FRESH != 0);
        assert_eq!(fresh, [true; 2], "{after} cycles after the question");
        robot.steps(100);
    }
}

/// Goal: a reply that arrives by the deadline is read, although an unexpected frame precedes it.
/// Method: both arrive after the first read of the cycle.
#[test]
fn reply_at_deadline_is_read_behind_other_frames() {
    let (mut robot, reads) = counted(robot::three_motors());
    let joints = robot.activate();
    for _ in 0..100 {
        robot.follow(&joints);
    }
    robot.disturb("knee delayed 60us");
    reads.is_followed_by_another.set(true);
    reads.count.set(0);
    robot.follow(&joints);
    assert_eq!((fresh(&mut robot), reads.count.get(), robot.bus(0).unexpected_id), (3, 3, 1));
}

/// Late replies of other motors are also read before the next decision on the bus of a missing
/// motor.
#[test]
fn always_late_motor_beside_excluded_one_is_lost() {
    let mut settings = robot::three_motors();
    settings.motors[1].may_be_excluded = true;
    settings.motors[1].excluded = true;
    let (mut robot, _) = counted(settings);
    robot.disturb("thigh off");
    let joints = robot.activate();
    let arrival = Duration::from_nanos(robot.joint(2).receive_ns - robot.state().tick_ns);
    let delay = robot.settings.cycle.reply_deadline - arrival + Duration::from_micros(100);
    robot.disturb(&format!("knee delayed {}us", delay.as_micros()));
    robot.follow_until(&joints, 100, |robot| robot.cause().is_some());
    assert_eq!(robot.cause(), Some(Cause::MotorLost));
}

/// Goal: no traffic makes a cycle exceed its budget of system calls.
/// Method: each fault on one motor, and on one motor of each bus. The test counts sleeps, waits and
/// reads.
#[test]
fn system_calls_stay_within_budget_under_any_traffic() {
    let faults = [
        "off",
        "garbage",
        "short",
        "duplicate",
        "reorder",
        "delayed 200us",
        "delayed 1ms",
        "delayed 60ms",
        "ok",
    ];
    for settings in [robot::three_motors(), robot::quadruped()] {
        let buses = settings.buses.len();
        for disturbed in [1, buses] {
            let (mut robot, reads) = counted(settings.clone());
            let budget = 1 + (3 * buses + 3) + disturbed;
            for fault in faults {
                for bus in 0..disturbed {
                    let motor =
                        settings.motors.iter().find(|motor| motor.bus == bus).expect("each bus has one");
                    robot.disturb(&format!("{} {fault}", motor.name));
                }
                let calls = (0..300).map(|_| {
                    reads.count.set(0);
                    robot.clock.waits.set(0);
                    robot.step();
                    reads.count.get() + robot.clock.waits.get() as usize
                });
                let most = calls.max().expect("cycles ran");
                assert!(
                    most <= budget,
                    "{disturbed} of {buses} buses {fault}: {most} calls, budget {budget}"
                );
            }
        }
    }
}

// The sleep for replies and busy polling, on virtual time.

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
