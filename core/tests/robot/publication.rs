//! Time from the last reply of a cycle to the publication of its states, on virtual time.

use core::num::NonZero;
use motord_bus::{Bus, Duration, Frame, Inbox, Instant, Readiness, Sent};
use motord_harness::robot;
use motord_harness::robot::line::Wire;
use motord_harness::robot::random::Random;
use motord_harness::robot::{Robot, Shared};
use motord_settings::settings::Settings;
use motord_simulator::SharedBus;
use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

/// Time of one read.
const READ: Duration = Duration::from_micros(2);

/// A bus whose reads take time.
struct Costly {
    bus: SharedBus,
    now: Arc<OnceLock<Shared<Instant>>>,
    reads: Shared<usize>,
}

impl Bus for Costly {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        self.bus.send(now, frames)
    }

    /// Takes what has arrived when the read begins, as a system call does: `now` may be older.
    fn receive(&mut self, _: Instant, inbox: &mut Inbox) {
        let now = self.now.get().expect("the clock is set");
        self.bus.receive(now.get(), inbox);
        now.set(now.get() + READ);
        self.reads.set(self.reads.get() + 1);
    }

    fn readiness(&self) -> Readiness<'_> {
        self.bus.readiness()
    }
}

/// Returns a robot whose reads take [`READ`], and their number.
fn costly(settings: Settings) -> (Robot, Shared<usize>) {
    let simulated = Robot::new(settings.clone(), 1);
    let (now, reads) = (Arc::new(OnceLock::new()), Shared::default());
    let wires = simulated.buses.iter().map(|wire| {
        let Wire::Bus(bus) = wire else { unreachable!("the robot has no line") };
        Box::new(Costly { bus: bus.clone(), now: now.clone(), reads: reads.clone() }) as Box<dyn Bus>
    });
    let mut robot = Robot::on(wires.collect(), simulated.now(), settings);
    drop(now.set(robot.clock.now.clone()));
    robot.buses = simulated.buses;
    (robot, reads)
}

/// Which motors get a command in each cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Commanded {
    /// All.
    Each,
    /// All but the first, which is excluded: ten times a second.
    AllButOne,
    /// Every second one.
    InTurns,
}

/// A robot and what it does.
#[derive(Debug, Clone, Copy)]
struct Case {
    protocol: &'static str,
    buses: u8,
    /// On each bus.
    motors: u8,
    has_imu: bool,
    moves: bool,
    commanded: Commanded,
}

impl Case {
    fn draw(random: &mut Random) -> Self {
        Self {
            protocol: *random.pick(&["mit", "gim"]),
            buses: 1 + random.below(8) as u8,
            motors: 1 + random.below(6) as u8,
            has_imu: random.once_in(2),
            moves: random.once_in(2),
            commanded: *random.pick(&[Commanded::Each, Commanded::AllButOne, Commanded::InTurns]),
        }
    }

    fn settings(self) -> Settings {
        let mut text = String::from("[cycle]\nrate-hz = 250\n[safety]\nfault-poll-hz = 0\n");
        for bus in 0..self.buses {
            text += &format!("[[bus]]\nname = \"{bus}\"\ntype = \"simulated\"\n");
            for id in 1..=self.motors {
                let motor = robot::motor(id, &format!("{bus}-{id}"), &bus.to_string(), "");
                text += &motor.replace("\"mit\"", &format!("\"{}\"", self.protocol));
            }
        }
        if self.has_imu {
            text += "[[imu]]\nname = \"base\"\ntype = \"damiao\"\nbus = \"0\"\nrate-hz = 50\n\
                     can-id = 0x21\nmaster-id = 0x31\n";
        }
        let mut settings = robot::settings(&text);
        settings.cycle.indicator_hz = 0.0;
        match self.commanded {
            Commanded::Each => {}
            Commanded::AllButOne => {
                (settings.motors[0].excluded, settings.motors[0].may_be_excluded) = (true, true);
            }
            Commanded::InTurns => {
                settings.buses.iter_mut().for_each(|bus| bus.every = NonZero::new(2).expect("not 0"));
            }
        }
        settings
    }
}

/// The replies to a robot in a cycle, and its publication.
struct Outcome {
    /// Number of replies on each bus.
    replies: Vec<usize>,
    last_reply: Duration,
    published: Duration,
    calls: usize,
}

/// Runs one cycle. `None` without a reply.
fn run_cycle(robot: &mut Robot, reads: &Shared<usize>) -> Option<Outcome> {
    robot.take_replies();
    robot.take_sent();
    reads.set(0);
    robot.clock.waits.set(0);
    let tick = robot.next();
    robot.step();
    let calls = reads.get() + robot.clock.waits.get() as usize;
    let (state, replies) = (robot.state(), robot.take_replies());
    let last_reply = replies.iter().map(|reply| reply.at).max()?.since(tick);
    let published = Instant::from_nanos(state.publish_ns).since(tick);
    let counts = (0..robot.buses.len()).map(|bus| replies.iter().filter(|reply| reply.bus == bus).count());
    Some(Outcome { replies: counts.collect(), last_reply, published, calls })
}

/// Goal: no cycle waits after its last reply but for the reads of its buses. Method: random robots
/// on virtual time, whose frames have stuff bits. A cycle may wait for a reply as late as the
/// latest to as many frames before it: it cannot know that this one is sooner.
#[test]
fn states_follow_last_reply_by_one_read() {
    robot::for_each_seed("publication", 40, |seed| {
        let case = Case::draw(&mut Random::new(seed));
        let (mut robot, reads) = costly(case.settings());
        let buses = usize::from(case.buses);
        let mut joints = if case.moves { robot.activate() } else { Vec::new() };
        robot.steps(500);
        let (start, mut latest) = (joints.clone(), BTreeMap::new());
        for cycle in 0..600_u16 {
            for (joint, start) in joints.iter_mut().zip(&start) {
                joint.position = start.position + 0.1 * (0.02 * f32::from(cycle)).sin();
            }
            robot.send(&joints);
            let Some(outcome) = run_cycle(&mut robot, &reads) else { continue };
            let latest = latest.entry(outcome.replies).or_insert(outcome.last_reply);
            *latest = outcome.last_reply.max(*latest);
            let most = *latest + (1 + buses as u32) * READ;
            let Outcome { published, last_reply, calls, .. } = outcome;
            assert!(
                cycle < 200 || published <= most,
                "{case:?}, cycle {cycle}: {published:?} after the tick, {last_reply:?} the last reply, {latest:?} the latest"
            );
            assert!(calls <= 1 + 3 * buses + 3 + buses, "{case:?}: {calls}");
        }
    });
}
