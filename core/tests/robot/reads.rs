//! Number of reads of a cycle, and of frames that each requests.

use core::num::NonZero;
use motord_bus::{Bus, Content, Duration, Frame, FrameId, Inbox, Instant, Readiness, Sent};
use motord_harness::robot;
use motord_harness::robot::line::Wire;
use motord_harness::robot::{Robot, Shared};
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
