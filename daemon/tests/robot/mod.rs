//! A whole robot on virtual time: the real cycle and the simulated motors, with a test as client, operator and saboteur.
//!
//! Method: one virtual clock moves only when the cycle sleeps or waits, so a run is the same every time. What reached
//! the wire is recorded by the buses and decoded by the invariant checker, not by the daemon's codec.

#![allow(dead_code, unreachable_pub, reason = "each test file uses its own part of the robot")]

pub mod checker;
pub mod fuzz_client;
pub mod line;
pub mod port;
pub mod random;

use line::{SharedLine, Wire};
use motord::buses;
use motord_bus::{Bus, Content, Duration, Frame, FrameId, Instant, Readiness, Ready};
pub use motord_checker::codec::Meaning;
use motord_checker::run::Command;
pub use motord_checker::run::Reply;
use motord_configuration::{self as config, Machine};
use motord_core::clock::Clock;
use motord_core::control::Event;
use motord_core::cycle::{Cycle, LocalClient, Tick, assemble};
use motord_core::settings::Settings;
use motord_shared::{
    AdminReply, AdminRequest, BusState, Cause, GroupState, JointSetpoint, JointState, Lease, MotorMode,
    Operation, Phase, Refusal, SetpointMessage, StateMessage,
};
use motord_simulator::{
    BusSettings, Direction, FaultVerb, Motor, MotorSettings, Plant, SerialSlave, SharedBus, SimulatedBus,
    couple,
};
use std::panic::RefUnwindSafe;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex};

pub const PERIOD: Duration = Duration::from_millis(1);

/// The configuration of the common harness: three motors with ids 1 to 3 on one bus, strict as on a robot.
pub fn three_motors() -> Settings {
    let mut text = String::from(
        "[cycle]\nrate-hz = 1000\n[safety]\nsetpoint-timeout-ms = 20\n[[bus]]\nname = \"can\"\ntype = \"simulated\"\n",
    );
    for (id, name) in [(1, "hip"), (2, "thigh"), (3, "knee")] {
        text += &motor(id, name, "can", "");
    }
    settings(&text)
}

/// Twelve motors on four buses, as the shipped configuration of a robot, but simulated.
pub fn quadruped() -> Settings {
    let mut text = String::from("[safety]\nsetpoint-timeout-ms = 20\n");
    for bus in ["front-left", "front-right", "rear-left", "rear-right"] {
        text += &format!("[[bus]]\nname = \"{bus}\"\ntype = \"simulated\"\n");
    }
    for bus in ["front-left", "front-right", "rear-left", "rear-right"] {
        for (id, name) in [(1, "hip"), (2, "thigh"), (3, "knee")] {
            text += &motor(id, &format!("{bus}-{name}"), bus, "");
        }
    }
    settings(&text)
}

/// One `[[motor]]` of the harness, with more keys in `more`.
pub fn motor(id: u8, name: &str, bus: &str, more: &str) -> String {
    format!(
        "[[motor]]\nname = \"{name}\"\nbus = \"{bus}\"\nid = {id}\nprotocol = \"mit\"\nmodel = \"GIM8108-8\"\n{more}\n\
         [motor.limits]\nposition-rad = [-3.0, 3.0]\nvelocity-rad-s = 20.0\ntorque-nm = 20.0\n\
         torque-slew-nm-per-s = 100.0\n"
    )
}

/// A configuration that must be good.
pub fn settings(text: &str) -> Settings {
    let loaded = config::parse(Path::new("test.toml"), text.as_bytes(), &Machine::here());
    loaded.unwrap_or_else(|error| panic!("{error}")).settings
}

/// A value that a test shares with the cycle.
#[derive(Debug, Clone, Default)]
pub struct Shared<T>(Arc<Mutex<T>>);

impl<T: Copy + Default> Shared<T> {
    pub fn new(value: T) -> Self {
        Self(Arc::new(Mutex::new(value)))
    }

    pub fn get(&self) -> T {
        *self.0.lock().expect("nobody panics with it")
    }

    pub fn set(&self, value: T) {
        *self.0.lock().expect("nobody panics with it") = value;
    }

    /// Leaves nothing.
    pub fn take(&self) -> T {
        std::mem::take(&mut self.0.lock().expect("nobody panics with it"))
    }
}

/// Virtual time.
#[derive(Debug, Clone)]
pub struct Virtual {
    now: Shared<Instant>,
    /// How long each reading of the clock takes.
    pub reading: Shared<Duration>,
    /// How often the cycle slept, or waited for buses.
    pub waits: Shared<u32>,
    /// How much too late the next sleep ends.
    pub late: Shared<Duration>,
    /// The next sleep ends at this time, unless it is to end later.
    pub wakes_at: Shared<Option<Instant>>,
    /// How much too late every sleep ends.
    pub always_late: Shared<Duration>,
    /// How long the computer was suspended.
    pub suspended: Shared<Duration>,
    /// The next reading of the clock panics.
    pub broken: Shared<bool>,
    /// After so many further readings of the clock the process is frozen for so long.
    pub freeze: Shared<Option<(u32, Duration)>>,
}

impl Clock for Virtual {
    fn now(&self) -> Instant {
        assert!(!self.broken.take(), "a panic in the cycle, as a test asked for");
        let frozen = match self.freeze.take() {
            Some((0, frozen)) => frozen,
            later => {
                self.freeze.set(later.map(|(readings, frozen)| (readings - 1, frozen)));
                Duration::ZERO
            }
        };
        self.now.set(self.now.get() + self.reading.get() + frozen);
        self.now.get()
    }

    fn now_and_suspended(&self) -> (Instant, Duration) {
        (self.now(), self.suspended.get())
    }

    fn sleep_until(&mut self, instant: Instant) {
        self.waits.set(self.waits.get() + 1);
        let end = self.wakes_at.take().unwrap_or(instant).max(instant);
        self.now.set(self.now.get().max(end + self.late.take() + self.always_late.get()));
    }

    fn wait(&mut self, readiness: &[Readiness<'_>], until: Instant) -> Ready {
        self.waits.set(self.waits.get() + 1);
        let wake = readiness.iter().fold(until, |wake, readiness| match *readiness {
            Readiness::At(at) => wake.min(at),
            _ => wake,
        });
        self.now.set(self.now.get().max(wake));
        let now = self.now.get();
        Ready::of(readiness.iter().map(|readiness| matches!(*readiness, Readiness::At(at) if at <= now)))
    }
}

/// A frame to a motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sent {
    /// When the cycle handed it over.
    pub ready: Instant,
    /// The end of the frame.
    pub at: Instant,
    /// Which bus.
    pub bus: usize,
    /// Which motor, by its arbitration id.
    pub id: u16,
    /// The bytes.
    pub bytes: [u8; 8],
    pub meaning: Meaning,
}

impl Sent {
    /// As the invariant checker knows it.
    pub fn command(&self) -> Command {
        let id = FrameId::new(self.id).expect("an id has eleven bits");
        Command { ready: self.ready, bus: self.bus, frame: Frame::full(id, self.bytes) }
    }
}

/// The robot, its client, and what can be done to both.
pub struct Robot {
    pub settings: Settings,
    pub cycle: Cycle,
    pub client: LocalClient,
    pub clock: Virtual,
    pub buses: Vec<Wire>,
    tick: Tick,
    /// Frames to motors since the last [`Robot::take_sent`].
    sent: Vec<Sent>,
    /// Frames to the host since the last [`Robot::take_replies`].
    replies: Vec<Reply>,
    /// Events for the log since the last [`Robot::take_events`].
    events: Vec<Event>,
}

impl Robot {
    pub fn new(settings: Settings, seed: u64) -> Self {
        Self::built(settings, seed, |_, _| {})
    }

    /// A robot that is not built as it is configured: `build` sees each bus and its motors before they exist.
    pub fn built(
        settings: Settings,
        seed: u64,
        build: impl FnMut(&mut BusSettings, &mut Vec<MotorSettings>),
    ) -> Self {
        Self::begun_at(Instant::from_nanos(1_000_000_000), settings, seed, build)
    }

    /// A robot whose clock tells `start` in the beginning.
    pub fn begun_at(
        start: Instant,
        settings: Settings,
        seed: u64,
        build: impl FnMut(&mut BusSettings, &mut Vec<MotorSettings>),
    ) -> Self {
        let buses = simulated(&settings, seed, build);
        let open = |(index, wire): (usize, &Wire)| wire.open(&settings, index).expect("it is plugged in");
        let opened = buses.iter().enumerate().map(open).collect();
        Self { buses, ..Self::on(opened, start, settings) }
    }

    /// A robot whose shafts `plant` moves.
    pub fn with_plant(settings: Settings, seed: u64, plant: impl Plant + 'static) -> Self {
        let buses: Vec<_> = (0..settings.buses.len())
            .map(|bus| SharedBus::new(simulated_bus(&settings, bus, seed, &mut |_, _| {})))
            .collect();
        let opened = couple(&buses, plant).into_iter().map(|bus| Box::new(bus) as Box<dyn Bus>).collect();
        let buses = buses.into_iter().map(Wire::Bus).collect();
        Self { buses, ..Self::on(opened, Instant::from_nanos(1_000_000_000), settings) }
    }

    /// The cycle alone, on buses that are not simulated here. What it sends is theirs to record.
    pub fn on(buses: Vec<Box<dyn Bus>>, start: Instant, settings: Settings) -> Self {
        let clock = Virtual {
            now: Shared::new(start),
            reading: Shared::default(),
            waits: Shared::default(),
            late: Shared::default(),
            wakes_at: Shared::default(),
            always_late: Shared::default(),
            suspended: Shared::default(),
            broken: Shared::default(),
            freeze: Shared::default(),
        };
        let (cycle, ends) = assemble(&settings, buses, clock.clone(), 7);
        let tick = Tick { number: 1, at: start };
        Self {
            settings,
            cycle,
            client: LocalClient::new(ends),
            clock,
            buses: Vec::new(),
            tick,
            sent: Vec::new(),
            replies: Vec::new(),
            events: Vec::new(),
        }
    }

    pub fn now(&self) -> Instant {
        self.clock.now()
    }

    /// When the next cycle should begin.
    pub fn next(&self) -> Instant {
        self.tick.at
    }

    /// One cycle.
    pub fn step(&mut self) {
        self.cycle_only();
        while self.client.record().is_some() {}
        while let Some((_, event)) = self.client.event() {
            self.events.push(event);
        }
        for bus in 0..self.buses.len() {
            self.collect_record(bus);
        }
    }

    /// One cycle, whose record the caller takes.
    pub fn cycle_only(&mut self) {
        self.tick = self.cycle.run(self.tick);
    }

    pub fn steps(&mut self, cycles: usize) {
        (0..cycles).for_each(|_| self.step());
    }

    /// Takes what was on the wire of a bus; every step does.
    pub fn collect_record(&mut self, bus: usize) {
        for recorded in self.buses[bus].take_record() {
            let (at, frame) = (recorded.at, recorded.frame);
            if recorded.direction == Direction::ToHost {
                self.replies.push(Reply { at, bus, frame });
                continue;
            }
            let id = frame.id().raw();
            let motor =
                self.settings.motors.iter().find(|motor| motor.bus == bus && u16::from(motor.id) == id);
            let ranges = checker::ranges(motor.expect("frames go to motors of the bus"));
            let bytes = frame.payload().try_into().expect("every command has eight bytes");
            self.sent.push(Sent {
                ready: recorded.ready,
                at,
                bus,
                id,
                bytes,
                meaning: Meaning::of(bytes, &ranges),
            });
        }
    }

    /// Frames that the motors heard since the last call.
    pub fn take_sent(&mut self) -> Vec<Sent> {
        std::mem::take(&mut self.sent)
    }

    /// Frames that the motor with this id heard since the last call. Those of the other motors are forgotten.
    pub fn take_sent_to(&mut self, id: u16) -> Vec<Sent> {
        self.take_sent().into_iter().filter(|sent| sent.id == id).collect()
    }

    /// Frames to the host since the last call.
    pub fn take_replies(&mut self) -> Vec<Reply> {
        std::mem::take(&mut self.replies)
    }

    /// Events for the log since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// The host hears a frame that none of the motors sent.
    pub fn hear(&mut self, bus: usize, id: u16, payload: &[u8]) {
        let now = self.now();
        match &self.buses[bus] {
            Wire::Bus(bus) => {
                let id = FrameId::new(id).expect("an id has eleven bits");
                let frame = Frame::new(id, payload).expect("a frame has at most eight bytes");
                bus.lock().deliver(now, Content::Frame(frame));
            }
            Wire::Line(line) => line.hear(id as u8, payload),
        }
    }

    /// Opens a bus again that the cycle gave up, as the daemon's own thread does, if it can be opened.
    pub fn reopen(&mut self, bus: usize) {
        let Some(opened) = self.buses[bus].open(&self.settings, bus) else { return };
        assert!(self.client.supply().hand_over(bus, opened), "there is room for every bus");
    }

    /// The truth about a motor, which it would not tell.
    pub fn truth(&self, joint: usize) -> Motor {
        let motor = &self.settings.motors[joint];
        let found = |bus: &mut SimulatedBus| bus.motor(&motor.name).cloned();
        self.buses[motor.bus].with(found).expect("every joint has a motor")
    }

    pub fn state(&mut self) -> StateMessage {
        *self.client.state()
    }

    pub fn joint(&mut self, index: usize) -> JointState {
        self.state().joints[index]
    }

    pub fn bus(&mut self, index: usize) -> BusState {
        self.state().buses[index]
    }

    pub fn mode(&mut self, index: usize) -> MotorMode {
        self.joint(index).mode.try_into().expect("modes are known")
    }

    pub fn group(&mut self) -> GroupState {
        self.state().groups[0]
    }

    pub fn phase(&mut self) -> Phase {
        self.group().phase.try_into().expect("phases are known")
    }

    pub fn cause(&mut self) -> Option<Cause> {
        Cause::try_from(self.group().cause).ok()
    }

    /// Asks, and runs cycles until the answer is there: one for most, some for service requests.
    pub fn ask(&mut self, request: AdminRequest) -> Result<AdminReply, Refusal> {
        let asked = self.client.post(request).expect("the ring has room");
        for _ in 0..4000 {
            self.step();
            while let Some((ticket, reply)) = self.client.answer() {
                if ticket == asked {
                    return if reply.refusal == 0 { Ok(reply) } else { Err(refusal(reply)) };
                }
            }
        }
        panic!("no answer to {request:?}");
    }

    pub fn operate(&mut self, operation: Operation) -> Result<AdminReply, Refusal> {
        self.ask(AdminRequest { operation: operation.code(), group: 0, ..Default::default() })
    }

    pub fn claim(&mut self) -> Result<u64, Refusal> {
        Ok(self.operate(Operation::Claim)?.lease)
    }

    /// The lease of the first group that was granted last; 0 for none.
    pub fn lease(&self) -> u64 {
        self.client.lease(0).map_or(0, Lease::raw)
    }

    /// Asks without waiting for the answer, which bears the ticket that is returned.
    pub fn post(&mut self, request: AdminRequest) -> u32 {
        // A ring that is full means many requests are under way, and the client is told that it is busy.
        self.client.post(request).unwrap_or(0)
    }

    /// The next answer to what was posted.
    pub fn take_answer(&mut self) -> Option<(u32, AdminReply)> {
        self.client.answer()
    }

    /// A good message in the owner's name.
    pub fn message(&mut self, joints: &[JointSetpoint]) -> SetpointMessage {
        let now = self.now();
        self.client.message(0, now, joints).unwrap_or_else(|| message(0, 1, now, joints))
    }

    /// Hands a message to the cycle as the ipc thread does.
    pub fn deliver(&mut self, message: &SetpointMessage) {
        self.deliver_to(0, message);
    }

    pub fn deliver_to(&mut self, group: usize, message: &SetpointMessage) {
        self.client.deliver(group, message);
    }

    pub fn send(&mut self, joints: &[JointSetpoint]) {
        let message = self.message(joints);
        self.deliver(&message);
    }

    /// Every joint of the first group is asked to stay where it is, with these gains.
    pub fn hold(&mut self, kp: f32, kd: f32) -> Vec<JointSetpoint> {
        self.hold_group(0, kp, kd)
    }

    pub fn hold_group(&mut self, group: usize, kp: f32, kd: f32) -> Vec<JointSetpoint> {
        let state = self.state();
        let motors = self.settings.groups[group].motors.iter();
        motors
            .map(|&motor| JointSetpoint {
                position: state.joints[motor].position,
                kp,
                kd,
                ..Default::default()
            })
            .collect()
    }

    /// One cycle in which the owner sends `joints`.
    pub fn follow(&mut self, joints: &[JointSetpoint]) {
        self.send(joints);
        self.step();
    }

    /// From any stopped state to `Active`, with an owner that holds the joints where they are.
    pub fn activate(&mut self) -> Vec<JointSetpoint> {
        self.steps(10);
        if self.group().lease == 0 {
            self.claim().expect("the group is free");
        }
        let joints = self.hold(40.0, 1.0);
        self.follow(&joints);
        self.operate(Operation::Enable).unwrap_or_else(|refusal| panic!("{refusal}"));
        for _ in 0..200 {
            self.follow(&joints);
        }
        assert_eq!(self.phase(), Phase::Active, "{:?}", self.cause());
        self.take_sent();
        joints
    }

    /// Does `line`, as `motord-sim` would.
    pub fn disturb(&mut self, line: &str) {
        let verb: FaultVerb = line.parse().unwrap_or_else(|error| panic!("{line}: {error}"));
        let now = self.now();
        let done = self.buses.iter().any(|bus| bus.inject(now, &verb).is_ok());
        assert!(done, "{line}: nobody is called so");
    }

    /// Runs cycles with `joints` as setpoints until `end` holds, at most `cycles` of them.
    pub fn follow_until(&mut self, joints: &[JointSetpoint], cycles: usize, end: impl Fn(&mut Self) -> bool) {
        for _ in 0..cycles {
            if end(self) {
                return;
            }
            self.follow(joints);
        }
        assert!(end(self), "not within {cycles} cycles: {} for {:?}", self.phase(), self.cause());
    }

    /// The clock tells an earlier time than before, as only a broken one does.
    pub fn turn_clock_back(&mut self, back: Duration) {
        self.clock.now.set(self.now() - back);
    }

    /// The computer is suspended for `time`, which the cycle's clock does not tell.
    pub fn suspend(&mut self, time: Duration) {
        self.clock.suspended.set(self.clock.suspended.get() + time);
    }

    /// The next sleep of the cycle ends so long after its tick.
    pub fn oversleep(&mut self, late: Duration) {
        self.clock.wakes_at.set(Some(self.next() + late));
    }
}

/// A message that asks for `joints`.
pub fn message(lease: u64, sequence: u64, now: Instant, joints: &[JointSetpoint]) -> SetpointMessage {
    let mut message = SetpointMessage {
        lease,
        sequence,
        time_ns: now.as_nanos(),
        joint_count: joints.len() as u32,
        ..Default::default()
    };
    message.joints[..joints.len()].copy_from_slice(joints);
    message
}

fn refusal(reply: AdminReply) -> Refusal {
    reply.refusal.try_into().expect("refusals are known")
}

/// The buses of a configuration with their motors, as `build` changes them.
fn simulated(
    settings: &Settings,
    seed: u64,
    mut build: impl FnMut(&mut BusSettings, &mut Vec<MotorSettings>),
) -> Vec<Wire> {
    let wire = |index: usize| {
        let bus = simulated_bus(settings, index, seed, &mut build);
        match settings.buses[index].is_line() {
            true => Wire::Line(SharedLine::new(SerialSlave::new(bus, seed + index as u64), settings, index)),
            false => Wire::Bus(SharedBus::new(bus)),
        }
    };
    (0..settings.buses.len()).map(wire).collect()
}

fn simulated_bus(
    settings: &Settings,
    index: usize,
    seed: u64,
    build: &mut impl FnMut(&mut BusSettings, &mut Vec<MotorSettings>),
) -> SimulatedBus {
    let (bus, mut motors) = buses::physics(settings, index);
    // The queue is as the CAN interfaces of Linux are set up: two cycles, each with a question for a fault.
    let mut bus = BusSettings { record: 4096, tx_queue: 2 * (motors.len() + 1), ..bus };
    build(&mut bus, &mut motors);
    SimulatedBus::new(bus, motors, seed + index as u64)
}

/// A number from the environment, such as `MOTORD_SEEDS`.
pub fn number(variable: &str) -> Option<u64> {
    std::env::var(variable).ok().and_then(|text| text.parse().ok())
}

/// Runs `count` seeds on all processors, or as many as `MOTORD_SEEDS` says, or the one that `MOTORD_SEED` names. Tells how
/// long they took, and how to run one again that failed.
pub fn for_each_seed(test: &str, count: u64, run: impl Fn(u64) + Sync + RefUnwindSafe) {
    let begun = motord_bus::clock::monotonic();
    let seeds = match number("MOTORD_SEED") {
        Some(seed) => seed..seed + 1,
        None => 0..number("MOTORD_SEEDS").unwrap_or(count),
    };
    let (next, failed) = (AtomicU64::new(seeds.start), AtomicU64::new(u64::MAX));
    let work = || {
        while failed.load(Relaxed) == u64::MAX {
            let seed = next.fetch_add(1, Relaxed);
            if seed >= seeds.end {
                return;
            }
            if std::panic::catch_unwind(|| run(seed)).is_err() {
                failed.fetch_min(seed, Relaxed);
            }
        }
    };
    std::thread::scope(|scope| {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        (0..threads).for_each(|_| drop(scope.spawn(work)));
    });
    let seconds = number("MOTORD_ROBOT_SECONDS").map(|seconds| format!("MOTORD_ROBOT_SECONDS={seconds} "));
    let (failed, seconds) = (failed.into_inner(), seconds.unwrap_or_default());
    assert!(
        failed == u64::MAX,
        "run it alone with: MOTORD_SEED={failed} {seconds}cargo test -p motord --test {test}"
    );
    let took = motord_bus::clock::monotonic().since(begun);
    println!("{test}: seeds {seeds:?} took {took:.1?}");
}
