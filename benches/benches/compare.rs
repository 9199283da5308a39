//! The Rust side of `benches/compare`: the codec and round trips of motord, those of bare iceoryx2,
//! a bare wake-up, and the cycle for callgrind. Prints lines of a name, a median and a 99 %
//! quantile, ns. Both values of a codec are the time of one frame.

mod echo;
mod robots;

use clap::{Parser, Subcommand, ValueEnum};
use echo::{Daemon, INSTANCE, JOINTS, TIMEOUT};
use iceoryx2::prelude::{Config, Node, NodeBuilder, Path as SystemPath, SemanticString, ipc};
use iceoryx2::service::port_factory::{event, publish_subscribe};
use motord_bus::{Bus, Frame, Inbox, Instant as RobotTime, Readiness, Sent};
use motord_client::{Client, Setpoint};
use motord_core::cycle::{LocalClient, Tick, assemble};
use motord_harness::robot;
use motord_ports::{Payload, clock};
use motord_protocol::Scales;
use motord_protocol::mit::{ControlCodes, DecodeError, Impedance, State};
use motord_protocol::profile::STEADYWIN;
use motord_shared::{JointSetpoint, SetpointMessage, StateMessage};
use motord_simulator::SharedBus;
use nix::sys::eventfd::{EfdFlags, EventFd};
use std::hint::{black_box, spin_loop};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Untimed trips at the start.
const WARM_UP: usize = 200;
/// Number of alternations between a measurement and its bare wake-up. The load of other processes
/// changes within a second, and slows every wake-up down.
const TURNS: usize = 10;
/// Time of waiting after which a thread sleeps.
const PAUSE: Duration = Duration::from_micros(100);
/// Motors on a bus at 500 Hz, for any size of the robot.
const MOTORS_PER_BUS: usize = 4;
/// Number of different commands and replies of the codec; a power of two.
const FRAMES: usize = 256;

#[derive(Parser)]
struct Options {
    /// The default is the codec and the trips.
    #[command(subcommand)]
    what: Option<What>,
    /// Runs only a short check of each measurement.
    #[arg(long)]
    test: bool,
    /// Passed by cargo.
    #[arg(long, hide = true, global = true)]
    bench: bool,
}

#[derive(Subcommand)]
enum What {
    /// The bytes of a setpoint message and of a state message.
    Sizes,
    /// This many frames each way, and a checksum of the bytes and values.
    Codec { frames: usize },
    /// This many round trips of each kind, or of one, and as many wake-ups beside the deliveries.
    Trips { count: usize, kind: Option<Trip> },
    /// This many cycles of a robot with this number of motors.
    Cycles { motors: usize, count: u64 },
}

fn main() {
    let options = Options::parse();
    match options.what {
        None if options.test => {
            codec(FRAMES);
            trips(1, None);
            cycles(MOTORS_PER_BUS, 1);
        }
        None => {
            codec(1_000_000);
            trips(20_000, None);
        }
        Some(What::Sizes) => println!("{} {}", size_of::<SetpointMessage>(), size_of::<StateMessage>()),
        Some(What::Codec { frames }) => codec(frames),
        Some(What::Trips { count, kind }) => trips(count, kind),
        Some(What::Cycles { motors, count }) => cycles(motors, count),
    }
}

/// The timed trips.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Trip {
    /// From a setpoint to the states that answer it without a pause; the client polls.
    Spin,
    /// The same trip; the client sleeps, or goes to sleep.
    Event,
    /// From the publication of states to a client that has slept for [`PAUSE`].
    Delivery,
}

impl Trip {
    const fn name(self) -> &'static str {
        match self {
            Self::Spin => "spin",
            Self::Event => "event",
            Self::Delivery => "delivery",
        }
    }

    /// Returns the time from a setpoint to its answer.
    const fn pause(self) -> Duration {
        if matches!(self, Self::Delivery) { PAUSE } else { Duration::ZERO }
    }

    /// Returns the time of a trip, ns, that began with a setpoint at `begun_ns` and was answered at
    /// `published_ns`.
    fn time_ns(self, begun_ns: u64, published_ns: u64) -> u64 {
        clock::now_ns() - if self == Self::Delivery { published_ns } else { begun_ns }
    }
}

fn trips(count: usize, kind: Option<Trip>) {
    for trip in kind.map_or_else(|| Trip::value_variants().to_vec(), |kind| vec![kind]) {
        let turns = if trip == Trip::Delivery { TURNS.min(count) } else { 1 };
        for _ in 0..turns {
            if trip == Trip::Delivery {
                wake_up(count / turns);
            }
            iceoryx2_trips(count / turns, trip);
            motord_trips(count / turns, trip);
        }
    }
}

/// Prints the median and the 99 % quantile of `count` trips. Each call of `trip` returns its time,
/// ns.
fn time_trips(name: &str, count: usize, mut trip: impl FnMut() -> u64) {
    for _ in 0..WARM_UP {
        trip();
    }
    let mut times: Vec<_> = (0..count).map(|_| trip()).collect();
    times.sort_unstable();
    println!("{name} {} {}", times[count / 2], times[count * 99 / 100]);
}

/// Polls the clock for `time`.
fn stay_awake(time: Duration) {
    let begun = Instant::now();
    while begun.elapsed() < time {
        spin_loop();
    }
}

/// Measures from the write of another thread to an eventfd to the end of a read that has waited for
/// [`PAUSE`].
fn wake_up(count: usize) {
    let event = Arc::new(EventFd::from_flags(EfdFlags::EFD_SEMAPHORE).expect("the kernel gives one"));
    let (asked, ends) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)));
    let written = Arc::new(AtomicU64::new(0));
    let (bell, requests, ended, writes) =
        (Arc::clone(&event), Arc::clone(&asked), Arc::clone(&ends), Arc::clone(&written));
    let waker = std::thread::spawn(move || {
        let mut done = 0;
        while !ended.load(Ordering::Relaxed) {
            if requests.load(Ordering::Acquire) == done {
                spin_loop();
                continue;
            }
            done += 1;
            stay_awake(PAUSE);
            writes.store(clock::now_ns(), Ordering::Relaxed);
            bell.write(1).expect("a thread reads");
        }
    });
    time_trips("wake-up", count, || {
        asked.fetch_add(1, Ordering::Release);
        event.read().expect("a thread writes");
        clock::now_ns() - written.load(Ordering::Relaxed)
    });
    ends.store(true, Ordering::Relaxed);
    waker.join().expect("the waker ends");
}

fn motord_trips(count: usize, trip: Trip) {
    let runtime = tempfile::tempdir().expect("the temporary directory is writable");
    let _daemon = Daemon::start(runtime.path(), trip.pause());
    let client = Client::connect_in(runtime.path(), INSTANCE).expect("the daemon runs");
    client.set_silence(TIMEOUT);
    let mut claim = client.claim("all").expect("the group has no owner");
    let setpoints = [Setpoint::damping(1.0); JOINTS];
    time_trips(&format!("motord-{}", trip.name()), count, || {
        let begun_ns = clock::now_ns();
        claim.send(&setpoints).expect("the daemon runs");
        let taken = if trip == Trip::Spin { client.spin(TIMEOUT) } else { client.wait(TIMEOUT) };
        let state = black_box(taken.expect("the daemon answers"));
        trip.time_ns(begun_ns, state.publish_ns())
    });
}

/// Transfers the same messages through services of iceoryx2 alone. The other side spins, as
/// motord's does.
fn iceoryx2_trips(count: usize, trip: Trip) {
    let root = tempfile::tempdir().expect("the temporary directory is writable");
    let (open, opened) = std::sync::mpsc::channel();
    let (ends, directory) = (Arc::new(AtomicBool::new(false)), root.path().to_owned());
    let ended = Arc::clone(&ends);
    let echo = std::thread::spawn(move || {
        let services = Services::open(&directory);
        let setpoints = services.setpoint.subscriber_builder().create().expect("a slot is free");
        let states = services.state.publisher_builder().create().expect("a slot is free");
        let event = services.event.notifier_builder().create().expect("a slot is free");
        open.send(()).expect("the starting thread waits");
        let mut state = StateMessage::default();
        while !ended.load(Ordering::Relaxed) {
            let Some(setpoint) = setpoints.receive().expect("the services are there") else {
                spin_loop();
                continue;
            };
            stay_awake(trip.pause());
            (state.cycle, state.publish_ns) = (setpoint.0.sequence, clock::now_ns());
            states.send_copy(Payload(state)).expect("a subscriber is there");
            event.notify().expect("a listener is there");
        }
    });
    opened.recv().expect("the other end starts");
    let services = Services::open(root.path());
    let setpoints = services.setpoint.publisher_builder().create().expect("a slot is free");
    let states = services.state.subscriber_builder().create().expect("a slot is free");
    let event = services.event.listener_builder().create().expect("a slot is free");
    let mut setpoint = SetpointMessage::default();
    time_trips(&format!("iceoryx2-{}", trip.name()), count, || {
        setpoint.sequence += 1;
        let begun_ns = clock::now_ns();
        setpoints.send_copy(Payload(setpoint)).expect("a subscriber is there");
        loop {
            if trip != Trip::Spin {
                event.timed_wait(|_| (), Duration::from_secs(1)).expect("a notifier is there");
            }
            let state = states.receive().expect("the services are there");
            if let Some(state) = state.filter(|state| state.0.cycle == setpoint.sequence) {
                return trip.time_ns(begun_ns, state.0.publish_ns);
            }
        }
    });
    ends.store(true, Ordering::Relaxed);
    echo.join().expect("the other end ends");
}

/// The services of bare iceoryx2 in one thread.
struct Services {
    setpoint: publish_subscribe::PortFactory<ipc::Service, Payload<SetpointMessage>, ()>,
    state: publish_subscribe::PortFactory<ipc::Service, Payload<StateMessage>, ()>,
    event: event::PortFactory<ipc::Service>,
    _node: Node<ipc::Service>,
}

impl Services {
    fn open(root: &Path) -> Self {
        let mut config = Config::default();
        config
            .global
            .set_root_path(&SystemPath::new(root.as_os_str().as_encoded_bytes()).expect("a path of ASCII"));
        let node =
            NodeBuilder::new().config(&config).create::<ipc::Service>().expect("the directory is ours");
        let name = |name: &str| name.try_into().expect("a sound name");
        let of = |service| node.service_builder(&name(service));
        Self {
            setpoint: of("setpoint")
                .publish_subscribe::<Payload<SetpointMessage>>()
                .subscriber_max_buffer_size(1)
                .open_or_create()
                .expect("sound"),
            state: of("state")
                .publish_subscribe::<Payload<StateMessage>>()
                .subscriber_max_buffer_size(1)
                .open_or_create()
                .expect("sound"),
            event: of("cycle").event().open_or_create().expect("sound"),
            _node: node,
        }
    }
}

/// Returns different frames, the same as in `peers/codec.c`.
fn impedances() -> [Impedance; FRAMES] {
    let mut seed = 1_u32;
    let mut between = |low: f32, high: f32| {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        low + (high - low) * ((seed >> 8) as f32 / 16_777_216.0)
    };
    core::array::from_fn(|_| Impedance {
        position: between(-13.0, 13.0),
        velocity: between(-66.0, 66.0),
        kp: between(-1.0, 501.0),
        kd: between(-0.1, 5.1),
        torque: between(-230.0, 230.0),
    })
}

fn codec(frames: usize) {
    let scales = Scales::by_current(0.125, 8.0).expect("the constants of a GIM8108-8 are sound");
    // Opaque functions for the callers, as in C.
    let encode: Encode =
        black_box(|wanted, scales| ControlCodes::nearest(wanted, scales).ok().map(ControlCodes::pack));
    let decode: Decode = black_box(|_, reply, scales| STEADYWIN.decode_state(reply, scales));
    let wanted = impedances();
    let bytes = wanted.map(|wanted| encode(&wanted, &scales).expect("finite values"));
    let encoding = per_frame(frames, |frame| {
        let _bytes = encode(&wanted[frame % FRAMES], &scales);
    });
    let replies = bytes.map(|[a, b, c, d, e, ..]| [1, a, b, c, d, e]);
    let decoding = per_frame(frames, |frame| {
        let _state = decode(0.0, &replies[frame % FRAMES], &scales);
    });
    let mut sum = 14_695_981_039_346_656_037_u64;
    let mut add = |byte: u8| sum = (sum ^ u64::from(byte)).wrapping_mul(1_099_511_628_211);
    for (bytes, reply) in bytes.iter().zip(&replies) {
        bytes.iter().for_each(|byte| add(*byte));
        let state = decode(0.0, reply, &scales).expect("6 bytes are a state");
        let values = [state.position, state.velocity, state.torque];
        values.iter().flat_map(|value| value.to_le_bytes()).for_each(&mut add);
    }
    println!("motord-encode {encoding:.2} {encoding:.2}\nmotord-decode {decoding:.2} {decoding:.2}");
    println!("motord-sum {sum:016x}");
}

type Encode = fn(&Impedance, &Scales) -> Option<[u8; 8]>;
/// The layout of the profile is a constant, the scales are not. The number has no meaning: it
/// clears the register of which the first conversion writes half. gcc's code clears it, LLVM's does
/// not. Without it each call would wait for the previous one.
type Decode = fn(f64, &[u8], &Scales) -> Result<State, DecodeError>;

/// Returns the least time of ten runs, ns for one frame.
fn per_frame(frames: usize, mut once: impl FnMut(usize)) -> f64 {
    let mut run = || {
        let begun = Instant::now();
        (0..frames).for_each(&mut once);
        begun.elapsed().as_secs_f64() * 1e9 / frames as f64
    };
    (0..10).map(|_| run()).fold(f64::INFINITY, f64::min)
}

/// A bus whose calls callgrind can separate from the cycle's.
struct Apart(SharedBus);

impl Bus for Apart {
    #[inline(never)]
    fn send(&mut self, now: RobotTime, frames: &[Frame]) -> Sent {
        self.0.send(now, frames)
    }

    #[inline(never)]
    fn receive(&mut self, now: RobotTime, inbox: &mut Inbox) {
        self.0.receive(now, inbox);
    }

    #[inline(never)]
    fn readiness(&self) -> Readiness<'_> {
        self.0.readiness()
    }
}

fn cycles(motors: usize, count: u64) {
    let mut robot = robot::Robot::new(robots::with(motors, MOTORS_PER_BUS, 500), 1);
    let buses = robot.buses.iter().map(|bus| Box::new(Apart(bus.bus().clone())) as Box<dyn Bus>).collect();
    let (cycle, ends) = assemble(&robot.settings, buses, robot.clock.clone(), 7);
    (robot.cycle, robot.client) = (cycle, LocalClient::new(ends));
    let joints: Vec<JointSetpoint> = robot.activate();
    let state = robot.state();
    let at = RobotTime::from_nanos(state.tick_ns) + robot.settings.cycle.period;
    let mut tick = Tick { number: state.cycle + 1, at };
    for _ in 0..count {
        robot.send(&joints);
        tick = robot.cycle.run(tick);
        while robot.client.record().is_some() {}
        while robot.client.event().is_some() {}
    }
}
