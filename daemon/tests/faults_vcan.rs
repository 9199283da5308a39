//! Items 13 to 19 of the fault catalogue on virtual CAN interfaces: the real cycle, the kernel's
//! errors, the machine's clock.
//!
//! The host and its motors use the two ends of a pair: the motors receive what has left the host's
//! queue. On a single interface every node receives queued frames.
//!
//! These tests create interfaces: they need root on a kernel with SocketCAN. `verify/rigs/test-can`
//! boots one and runs them there; elsewhere they are ignored.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use ::socketcan::{CanErrorFrame, CanSocket, Socket};
use motord::buses;
use motord_bus::Monotonic;
use motord_bus::socketcan::{self, InterfaceName, Link, SocketCanBus};
use motord_bus::transport::SocketCan;
use motord_bus::{Bus, Content, Duration, ErrorFrame, Frame, FrameId, IdFilter, Inbox, clock, wait};
use motord_checker::protocol::ranges::Ranges;
use motord_core::cycle::{Cycle, LocalClient, Tick, assemble};
use motord_deadman::channel::{Answer, Channel, Listener, Request};
use motord_deadman::heartbeat::Heartbeat;
use motord_deadman::interfaces::expect_interface;
use motord_deadman::safe_frames::SafeFrames;
use motord_deadman::server::Server;
use motord_harness::robot::{self, Meaning};
use motord_ports::instance::Instance;
use motord_settings::settings::Settings;
use motord_shared::message::IMU_LOST;
use motord_shared::{
    BusCondition, BusState, Cause, GroupState, JointSetpoint, MotorMode, Operation, Phase, StateMessage,
};
use motord_simulator::Bridge;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::JoinHandle;

const BITRATE: u32 = 1_000_000;

/// Runs `ip` or `tc`.
fn run(command: &str) {
    let mut words = command.split_whitespace();
    let status = Command::new(words.next().unwrap()).args(words).status().unwrap();
    assert!(status.success(), "{command}: {status}");
}

/// Three motors at 250 Hz, without fault polls: a cycle sends three frames. The timeouts are long,
/// since `ip` and `tc` run between the cycles.
fn configured(interface: &str, imus: &str) -> Settings {
    let mut text = format!(
        "[cycle]\nrate-hz = 250\nmax-lateness-ms = 500\n[safety]\nsetpoint-timeout-ms = 500\nfault-poll-hz = 0\n\
         start-timeout-ms = 5000\ndamp-seconds = 0.2\n\
         [[bus]]\nname = \"can\"\ntype = \"socketcan\"\ninterface = \"{interface}\"\nbitrate = {BITRATE}\n"
    );
    for (id, name) in [(1, "hip"), (2, "thigh"), (3, "knee")] {
        text += &robot::motor(id, name, "can", "");
    }
    robot::settings(&(text + imus))
}

/// Simulated motors on an interface, as other nodes, on a separate thread.
struct Motors {
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Motors {
    fn on(interface: InterfaceName, settings: &Settings) -> Self {
        let simulated = buses::simulate(settings, 0, 1);
        let end = SocketCan { interface: interface.to_string(), bitrate: BITRATE };
        let mut bridge = Bridge::open(simulated, &end).unwrap();
        let end = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&end);
        let serve = move || {
            while !ended.load(Ordering::Relaxed) {
                let now = clock::monotonic();
                bridge.serve(now);
                let _ready =
                    wait(&[bridge.readiness()], now, bridge.due().min(now + Duration::from_millis(10)));
            }
        };
        Self { end, thread: Some(std::thread::spawn(serve)) }
    }
}

impl Drop for Motors {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        let ended = self.thread.take().unwrap().join();
        assert!(ended.is_ok() || std::thread::panicking(), "the motors panicked");
    }
}

/// A robot on a separate pair of interfaces, with an observer of the commands to its motors.
struct Robot {
    interface: InterfaceName,
    motor_side: InterfaceName,
    settings: Settings,
    cycle: Cycle,
    client: LocalClient,
    tick: Tick,
    observer: SocketCanBus,
    received: Vec<(u32, Meaning)>,
    motors: Option<Motors>,
}

impl Robot {
    fn new() -> Self {
        Self::with("")
    }

    /// Also has these IMUs.
    fn with(imus: &str) -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let [interface, motor_side] = ["host", "motors"].map(|end| format!("{end}{number}").parse().unwrap());
        plug_in(interface, motor_side);
        let settings = configured(interface.as_str(), imus);
        let bus = buses::open_one(&settings, 0).unwrap().bus;
        let (cycle, ends) = assemble(&settings, vec![bus], Monotonic, 7);
        Self {
            interface,
            motor_side,
            observer: observer(motor_side),
            received: Vec::new(),
            motors: Some(Motors::on(motor_side, &settings)),
            settings,
            cycle,
            client: LocalClient::new(ends),
            tick: Tick { number: 1, at: clock::monotonic() },
        }
    }

    /// Holds its joints in position.
    fn active() -> (Self, Vec<JointSetpoint>) {
        let mut robot = Self::new();
        let joints = robot.activate();
        (robot, joints)
    }

    fn activate(&mut self) -> Vec<JointSetpoint> {
        self.step_until(|robot| robot.are(MotorMode::Idle));
        if self.group().lease == 0 {
            self.operate(Operation::Claim);
        }
        let hold = |position| JointSetpoint { position, kp: 40.0, kd: 1.0, ..Default::default() };
        let joints: Vec<_> = self.state().joints().iter().map(|joint| hold(joint.position)).collect();
        self.follow(&joints);
        self.operate(Operation::Enable);
        for _ in 0..400 {
            self.follow(&joints);
        }
        assert_eq!(self.phase(), Phase::Active, "{}", self.group().cause);
        self.received();
        joints
    }

    fn step(&mut self) {
        self.tick = self.cycle.run(self.tick);
        while self.client.record().is_some() {}
        while self.client.event().is_some() {}
        self.listen();
    }

    fn steps(&mut self, cycles: usize) {
        (0..cycles).for_each(|_| self.step());
    }

    fn step_until(&mut self, end: impl Fn(&mut Self) -> bool) {
        for _ in 0..1000 {
            self.step();
            if end(self) {
                return;
            }
        }
        panic!("not within 1000 cycles: {:?}, {:?}, {:?}", self.bus(), self.group(), self.state().joints());
    }

    fn follow(&mut self, joints: &[JointSetpoint]) {
        self.client.send(0, clock::monotonic(), joints).unwrap();
        self.step();
    }

    /// Runs until the group is stopped. Returns the cause and the number of cycles.
    fn stopped_within(&mut self, joints: &[JointSetpoint], cycles: usize) -> (Cause, usize) {
        for cycle in 1..=cycles {
            self.follow(joints);
            if let Ok(cause) = Cause::try_from(self.group().cause) {
                return (cause, cycle);
            }
        }
        panic!("not stopped within {cycles} cycles: {:?}", self.bus());
    }

    /// Runs `command` on the host's interface between two cycles; the robot's time continues
    /// afterwards.
    fn disturb(&mut self, command: &str) {
        run(&command.replace("DEV", self.interface.as_str()));
        self.tick.at = clock::monotonic();
    }

    /// Returns the number of frames that wait in the queue of the host's interface.
    fn waiting(&self) -> u32 {
        let words = ["-s", "qdisc", "show", "dev", self.interface.as_str()];
        let output = Command::new("tc").args(words).output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let (_, backlog) = text.split_once("backlog ").unwrap();
        let frames = backlog.split_whitespace().nth(1).unwrap();
        frames.trim_end_matches('p').parse().unwrap()
    }

    /// Sends the error frame that the CAN controller of the interface would report.
    fn report(&self, class: u32, detail: u8) {
        let controller = CanSocket::open(self.interface.as_str()).unwrap();
        let error = CanErrorFrame::new_error(class, &[0, detail, 0, 0, 0, 0, 0, 0]).unwrap();
        controller.write_frame(&error).unwrap();
    }

    fn operate(&mut self, operation: Operation) {
        self.client.request(operation, 0).unwrap();
        for _ in 0..100 {
            self.step();
            if let Some((_, reply)) = self.client.answer() {
                assert_eq!(reply.refusal, 0, "{operation:?}");
                return;
            }
        }
        panic!("{operation:?} is not answered");
    }

    /// Commands to the motors since the last call: id and meaning.
    fn received(&mut self) -> Vec<(u32, Meaning)> {
        self.listen();
        std::mem::take(&mut self.received)
    }

    /// Reads the observer's frames; every step does, before its socket is full.
    fn listen(&mut self) {
        let torque_max = self.settings.motors[0].scales.torque.max();
        let mut inbox = Inbox::new();
        self.observer.receive(clock::monotonic(), &mut inbox);
        assert!(inbox.lost == 0 && inbox.free() > 0, "the observer must read more often");
        for arrival in inbox.arrivals() {
            if let Content::Frame(frame) = arrival.content {
                self.received.push((frame.id().raw(), meaning(&frame, torque_max)));
            }
        }
    }

    /// Checks that only safe frames were received in `cycles` cycles, and nothing started.
    fn rests_for(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.step();
            let received = self.received();
            assert!(received.iter().all(|(_, meaning)| meaning.is_safe()), "{received:?}");
        }
    }

    /// The motors reconnect, but only a reset and an enable move them.
    fn recovers_on_request(&mut self) {
        self.step_until(|robot| robot.are(MotorMode::Idle));
        self.rests_for(100);
        assert_eq!(self.phase(), Phase::Disarmed);
        self.operate(Operation::Reset);
        self.rests_for(100);
        self.activate();
    }

    fn state(&mut self) -> StateMessage {
        *self.client.state()
    }

    fn bus(&mut self) -> BusState {
        self.state().buses[0]
    }

    fn group(&mut self) -> GroupState {
        self.state().groups[0]
    }

    fn phase(&mut self) -> Phase {
        self.group().phase.try_into().unwrap()
    }

    fn are(&mut self, mode: MotorMode) -> bool {
        self.state().joints().iter().all(|joint| joint.mode == mode.code())
    }

    fn condition(&mut self) -> BusCondition {
        self.bus().condition.try_into().unwrap()
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.motors = None;
        let _already_removed = Command::new("ip").args(["link", "del", self.interface.as_str()]).status();
    }
}

fn plug_in(interface: InterfaceName, motor_side: InterfaceName) {
    run(&format!("ip link add dev {interface} type vxcan peer name {motor_side}"));
}

/// Receives the same frames as the motors.
fn observer(interface: InterfaceName) -> SocketCanBus {
    let ids = (1..=3).map(|id| IdFilter::exact(FrameId::from(id)));
    SocketCanBus::open(&socketcan::Settings {
        host_ids: ids.collect(),
        ..socketcan::Settings::new(interface, BITRATE)
    })
    .unwrap()
}

fn meaning(frame: &Frame, torque_max: f64) -> Meaning {
    Meaning::of(frame.payload().try_into().unwrap(), &Ranges::steadywin(torque_max))
}

const WARNING: u8 = 0x08;
const PASSIVE: u8 = 0x20;
const ACTIVE: u8 = 0x40;

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn error_frames_change_only_bus_knowledge() {
    let (mut robot, joints) = Robot::active();
    let before = robot.bus();
    robot.report(ErrorFrame::CONTROLLER, WARNING);
    robot.follow(&joints);
    let now = robot.bus();
    assert_eq!((now.errors - before.errors, now.malformed, now.unexpected_id), (1, 0, 0));
    assert_eq!((robot.condition(), robot.phase()), (BusCondition::Warning, Phase::Active));
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn bus_off_pauses_sending_and_resumes_with_stops() {
    let (mut robot, joints) = Robot::active();
    robot.report(ErrorFrame::BUS_OFF, 0);
    let (cause, cycles) = robot.stopped_within(&joints, 3);
    assert!(cause == Cause::BusOff && cycles <= 2, "{cause} after {cycles} cycles");
    robot.received();
    robot.steps(200);
    assert_eq!((robot.received(), robot.condition()), (vec![], BusCondition::Off));
    robot.report(ErrorFrame::RESTARTED, 0);
    robot.recovers_on_request();
    assert_eq!(robot.condition(), BusCondition::Active);
}

/// A HiPNUC of 200 Hz, and a DM-IMU-L1 that is asked in every cycle. Its samples and missing ones
/// add up to the cycles.
#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn imus_beside_motors_deliver_and_return() {
    const CYCLES: usize = 500;
    let mut alone = Robot::new();
    alone.step_until(|robot| robot.are(MotorMode::Idle));
    let missed = |robot: &mut Robot| robot.state().joints().iter().map(|joint| joint.missed).sum::<u32>();
    let missed_in = |robot: &mut Robot| {
        let before = missed(robot);
        robot.steps(CYCLES);
        missed(robot) - before
    };
    let without = missed_in(&mut alone);
    drop(alone);
    let mut robot = Robot::with(
        "[[imu]]\nname = 'head'\ntype = 'hipnuc-can'\nbus = 'can'\nrate-hz = 200\n\
         [[imu]]\nname = 'base'\ntype = 'damiao'\nbus = 'can'\ncan-id = 0x30\nmaster-id = 0x31\nrate-hz = 250\n",
    );
    let are_lost = |robot: &mut Robot| [0, 1].map(|imu| robot.state().imus()[imu].flags & IMU_LOST != 0);
    robot.step_until(|robot| robot.are(MotorMode::Idle) && are_lost(robot) == [false; 2]);
    let before = robot.state();
    let with = missed_in(&mut robot);
    let after = robot.state();
    let [head, base] = [0, 1].map(|imu| {
        let [before, after] = [&before, &after].map(|state| state.imus()[imu]);
        [after.sequence - before.sequence, u64::from(after.missing.wrapping_sub(before.missing))]
    });
    println!("missed replies: {without} without IMUs, {with} with; samples and missing: {head:?}, {base:?}");
    assert!(base[0] >= 450 && base[0] + base[1] <= 501, "{base:?} of {CYCLES} cycles");
    assert!(head[0] >= 350, "{head:?} in 2 s");
    let counted = |state: &StateMessage| {
        let bus = state.buses[0];
        (bus.unexpected_id, bus.malformed, bus.duplicate)
    };
    assert_eq!(counted(&after), counted(&before));
    robot.disturb("ip link set DEV down");
    robot.steps(2);
    assert_eq!(are_lost(&mut robot), [true; 2]);
    robot.disturb("ip link set DEV up");
    robot.step_until(|robot| are_lost(robot) == [false; 2]);
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn a_flapping_controller_warns_and_stops_nothing() {
    let (mut robot, joints) = Robot::active();
    for detail in [PASSIVE, ACTIVE].repeat(100) {
        robot.report(ErrorFrame::CONTROLLER, detail);
        robot.follow(&joints);
    }
    assert_eq!(
        (robot.phase(), robot.bus().errors, robot.condition()),
        (Phase::Active, 200, BusCondition::Active)
    );
}

/// The kernel's `ENOBUFS`, in the middle of one `sendmmsg`.
#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn partially_full_queue_drops_rest_of_cycle() {
    let (mut robot, joints) = Robot::active();
    let before = robot.bus();
    robot.disturb("tc qdisc add dev DEV root netem delay 2ms limit 2");
    robot.received();
    robot.follow(&joints);
    let now = robot.bus();
    assert_eq!((now.sent - before.sent, now.dropped - before.dropped), (2, 1));
    robot.disturb("tc qdisc del dev DEV root");
    let received: Vec<_> = robot.received().into_iter().map(|(id, _)| id).collect();
    assert_eq!(received, [1, 2], "the first two, and no frame is tried again");
    robot.follow(&joints);
    assert_eq!((robot.received().len(), robot.phase()), (3, Phase::Active));
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn queue_full_in_three_cycles_stops_group() {
    let (mut robot, joints) = Robot::active();
    robot.disturb("tc qdisc add dev DEV root netem delay 100s limit 1");
    let (cause, cycles) = robot.stopped_within(&joints, 4);
    assert_eq!((cause, cycles), (Cause::PowerLost, 4), "told in the cycle after the third");
    robot.disturb("tc qdisc del dev DEV root");
    robot.recovers_on_request();
}

/// Goal: frames that wait in the kernel while all motors are silent are never sent. Method: the
/// queue delays each frame by 100 s. motord discards the queue as its reconnector does, and no frame
/// waits any longer. The queue delays frames by 1 ms from then on, and the motors receive stops only.
#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn power_cut_discards_waiting_frames() {
    let (mut robot, joints) = Robot::active();
    assert_eq!(Link::discard_queue(robot.interface, None), Ok(false), "no frame waits");
    robot.disturb("tc qdisc add dev DEV root netem delay 100s limit 64");
    robot.received();
    let (cause, _) = robot.stopped_within(&joints, 12);
    assert_eq!((cause, robot.condition()), (Cause::PowerLost, BusCondition::Held));
    robot.steps(5);
    assert!(robot.waiting() > 10, "{} frames wait", robot.waiting());
    assert_eq!(Link::discard_queue(robot.interface, None), Ok(true));
    assert_eq!(robot.waiting(), 0);
    robot.disturb("tc qdisc change dev DEV root netem delay 1ms limit 64");
    let opened = buses::open_one(&robot.settings, 0).unwrap().bus;
    assert!(robot.client.supply().hand_over(0, opened));
    robot.tick.at = clock::monotonic();
    let mut received = Vec::new();
    for _ in 0..500 {
        robot.step();
        received.extend(robot.received());
    }
    assert!(!received.is_empty(), "probes arrive");
    assert!(received.iter().all(|(_, meaning)| meaning.is_safe()), "{received:?}");
    robot.disturb("tc qdisc del dev DEV root");
    robot.recovers_on_request();
}

/// The queue holds four frames, each for 40 ms. No reply may be later than 50 ms: a state that is
/// could be taken for the answer to a request for faults (docs/adr/0005).
#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn refused_frames_are_never_sent_later() {
    let (mut robot, joints) = Robot::active();
    let before = robot.bus().sent;
    robot.disturb("tc qdisc add dev DEV root netem delay 40ms limit 4");
    robot.received();
    for _ in 0..300 {
        robot.follow(&joints);
    }
    robot.disturb("tc qdisc del dev DEV root");
    let bus = robot.bus();
    let (accepted, received) = ((bus.sent - before) as usize, robot.received());
    assert!(bus.dropped >= 3, "{bus:?}");
    assert!(
        !received.is_empty() && received.len() <= accepted,
        "{} heard, {accepted} accepted",
        received.len()
    );
    let stale = received.iter().take_while(|(_, meaning)| !meaning.is_safe()).count();
    assert!(stale <= 4, "{stale} frames were in the queue");
    assert!(received[stale..].iter().all(|(_, meaning)| meaning.is_safe()), "{received:?}");
    robot.recovers_on_request();
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn interface_down_stops_group_and_returns_stopped() {
    let (mut robot, joints) = Robot::active();
    robot.disturb("ip link set DEV down");
    let (cause, cycles) = robot.stopped_within(&joints, 3);
    assert!(cycles <= 2, "{cycles}");
    assert_eq!((cause, robot.condition()), (Cause::BusGone, BusCondition::Down));
    robot.steps(100);
    robot.disturb("ip link set DEV up");
    robot.recovers_on_request();
}

#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn unplugged_interface_stops_group_and_returns_stopped() {
    let (mut robot, joints) = Robot::active();
    robot.disturb("ip link del DEV");
    let (cause, cycles) = robot.stopped_within(&joints, 3);
    assert!(cycles <= 2, "{cycles}");
    assert_eq!((cause, robot.condition()), (Cause::BusGone, BusCondition::Gone));
    robot.steps(100);
    plug_in(robot.interface, robot.motor_side);
    let opened = buses::open_one(&robot.settings, 0).unwrap().bus;
    robot.observer = observer(robot.motor_side);
    robot.motors = Some(Motors::on(robot.motor_side, &robot.settings));
    assert!(robot.client.supply().hand_over(0, opened));
    robot.tick.at = clock::monotonic();
    robot.recovers_on_request();
}

/// Goal: a robot that lost its adapters with its daemon is damped and stopped when they reconnect,
/// after any delay.
/// Method: a daemon registers, here from this thread, while its interface is missing. The interface
/// appears, disappears, and reappears when the daemon is dead and the damping would be over.
#[test]
#[ignore = "needs SocketCAN and root: run verify/rigs/test-can"]
fn switch_serves_an_interface_that_appears_later() {
    let [interface, motor_side]: [InterfaceName; 2] = ["late", "later"].map(|name| name.parse().unwrap());
    let settings = configured(interface.as_str(), "");
    let directory = tempfile::tempdir().unwrap();
    let instance = Instance::below(directory.path(), "test").unwrap();
    let mut server = Server::new(Listener::bind(&instance).unwrap(), expect_interface);

    let (heartbeat, pulse) = Heartbeat::create().unwrap();
    heartbeat.beat(1);
    let daemon = Channel::connect(&instance, motord_deadman::channel::TIMEOUT).unwrap();
    daemon.send(&Request::Register(SafeFrames::of(&settings)), Some(&pulse)).unwrap();
    for _ in 0..2 {
        server.turn(clock::monotonic() + Duration::from_millis(10));
    }
    assert_eq!(daemon.receive::<Answer>().unwrap().0, Answer::Registered);

    plug_in(interface, motor_side);
    run(&format!("ip link del {interface}"));
    drop(daemon);
    server.turn(clock::monotonic() + Duration::from_millis(10));
    let unserved = server.finish(clock::monotonic() + 3 * settings.safety.damp);
    assert_eq!(unserved, [interface.as_str()]);
    plug_in(interface, motor_side);
    run(&format!("ip link set {interface} up"));
    let mut observer = observer(motor_side);
    assert_eq!(server.finish(clock::monotonic() + Duration::from_secs(10)), [""; 0]);

    let torque_max = settings.motors[0].scales.torque.max();
    let mut frames = Vec::new();
    // More frames than one inbox holds.
    for _ in 0..2 {
        let mut received = Inbox::new();
        observer.receive(clock::monotonic(), &mut received);
        frames.extend(received.arrivals().iter().filter_map(|arrival| match arrival.content {
            Content::Frame(frame) => Some((frame.id().raw(), meaning(&frame, torque_max))),
            _ => None,
        }));
    }
    let (damped, stopped) = frames.split_at(frames.len() - 9);
    let is_damping = |meaning: &Meaning| matches!(meaning, Meaning::Control { kd, .. } if *kd > 0.0);
    assert!(damped.len() >= 15 && damped.iter().all(|(_, meaning)| is_damping(meaning)), "{damped:?}");
    assert!(stopped.iter().all(|(_, meaning)| *meaning == Meaning::Stop), "{stopped:?}");
    let ids: Vec<_> = frames.iter().map(|(id, _)| *id).collect();
    assert!(ids.chunks(3).all(|round| round == [1, 2, 3]), "{ids:?}");
    run(&format!("ip link del {interface}"));
}
