//! Frames of the sizes and rates of motord-remote, by plain UDP and by zenoh alone: what the network
//! costs without motord. `verify/rigs/remote-cost` runs it beside motord-remote.
//!
//! ```text
//! baseline robot udp|zenoh ADDRESS             sends states, until it is killed
//! baseline other udp|zenoh ADDRESS SECONDS     sends setpoints, and prints its latencies
//! baseline states ROBOT OTHER SECONDS          the delay of states by motord-remote, as clients see it
//! baseline counters ADDRESS NAME               prints the counters of a robot that is served
//! ```
//!
//! `ROBOT` and `OTHER` are `RUNTIME/INSTANCE`: of the robot, and of its mirror. Both sides run on one
//! computer: their clocks are the same, so times of one way are known.

use hdrhistogram::Histogram;
use motord_client::Client;
use motord_ports::clock::now_ns;
use motord_shared::packed::pack;
use motord_shared::{SetpointMessage, StateMessage};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::net::{SocketAddr, UdpSocket};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use zenoh::qos::{CongestionControl, Priority, Reliability};
use zenoh::{Config, Session, Wait};

/// As in the rig: of states, and of setpoints.
const STATES_HZ: f64 = 500.0;
const SETPOINTS_HZ: f64 = 200.0;
/// After the first state, before anything is recorded.
const WARM_UP: Duration = Duration::from_secs(3);
/// Bytes of the heads of motord-remote before a state, with one echo, and before a setpoint.
const STATE_HEAD: usize = 28 + 4 + 24;
const SETPOINT_HEAD: usize = 28 + 24 + 8;

type Take = Box<dyn FnMut(&[u8]) + Send>;
type Transmit = Box<dyn FnMut(&[u8])>;

fn main() {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let texts: Vec<_> = arguments.iter().map(String::as_str).collect();
    let seconds = |text: &str| Duration::from_secs_f64(text.parse().expect("a number"));
    match texts[..] {
        ["robot", kind, address] => robot(kind, address),
        ["other", kind, address, time] => println!("{}", other(kind, address, seconds(time))),
        ["states", robot, other, time] => println!("{}", states(robot, other, seconds(time))),
        ["counters", address, name] => println!("{}", counters(address, name)),
        _ => panic!("see the head of main.rs"),
    }
}

/// The numbers at the head of a frame.
#[derive(Clone, Copy, Default)]
struct Frame {
    sent_ns: u64,
    /// The newest frame of the other side: its time of sending, its transit, and how long it was held,
    /// ns.
    echo_sent_ns: u64,
    echo_transit_ns: u64,
    echo_held_ns: u64,
}

impl Frame {
    fn write(self, bytes: &mut [u8]) {
        let numbers = [self.sent_ns, self.echo_sent_ns, self.echo_transit_ns, self.echo_held_ns];
        for (bytes, number) in bytes.chunks_exact_mut(8).zip(numbers) {
            bytes.copy_from_slice(&number.to_le_bytes());
        }
    }

    fn read(bytes: &[u8]) -> Option<Self> {
        let mut numbers =
            bytes.chunks_exact(8).map(|part| u64::from_le_bytes(part.try_into().unwrap_or_default()));
        let mut next = || numbers.next();
        Some(Self {
            sent_ns: next()?,
            echo_sent_ns: next()?,
            echo_transit_ns: next()?,
            echo_held_ns: next()?,
        })
    }
}

/// The newest frame of the other side, and when it arrived, ns.
type Newest = Arc<Mutex<Option<(Frame, u64)>>>;

fn set(newest: &Newest, bytes: &[u8], now_ns: u64) {
    if let Some(frame) = Frame::read(bytes) {
        *newest.lock().expect("no thread panicked") = Some((frame, now_ns));
    }
}

/// Sends a frame of `size` bytes `hz` times a second while `goes_on`.
fn send_at(hz: f64, size: usize, newest: &Newest, mut send: Transmit, mut goes_on: impl FnMut() -> bool) {
    let (period, mut bytes) = (Duration::from_secs_f64(1.0 / hz), vec![0; size]);
    let mut next = Instant::now();
    while goes_on() {
        let newest = *newest.lock().expect("no thread panicked");
        let now = now_ns();
        let mut frame = Frame { sent_ns: now, ..Frame::default() };
        if let Some((echo, arrived)) = newest {
            frame.echo_sent_ns = echo.sent_ns;
            frame.echo_transit_ns = arrived.saturating_sub(echo.sent_ns);
            frame.echo_held_ns = now.saturating_sub(arrived);
        }
        frame.write(&mut bytes);
        send(&bytes);
        next += period;
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
}

fn robot(kind: &str, address: &str) {
    let newest = Newest::default();
    let of_receiver = Arc::clone(&newest);
    let take: Take = Box::new(move |bytes| set(&of_receiver, bytes, now_ns()));
    let send = match kind {
        "udp" => over_udp(UdpSocket::bind(address).expect("a free port"), None, take),
        _ => over_zenoh(
            &open("peer", "listen", address),
            ["baseline/state", "baseline/setpoint"],
            Priority::InteractiveHigh,
            take,
        ),
    };
    let size = STATE_HEAD + packed(state());
    send_at(STATES_HZ, size, &newest, send, || true);
}

/// Latencies, ns.
struct Latencies(Histogram<u64>);

impl Latencies {
    fn new() -> Self {
        Self(Histogram::new_with_bounds(1, 60_000_000_000, 3).expect("these bounds are valid"))
    }

    fn record(&mut self, ns: u64) {
        self.0.saturating_record(ns.max(1));
    }

    fn json(&self) -> Value {
        let us = |share| self.0.value_at_quantile(share) as f64 / 1e3;
        json!({"count": self.0.len(), "p50": us(0.5), "p99": us(0.99), "p99_9": us(0.999), "max": self.0.max() as f64 / 1e3})
    }
}

/// The times that the other computer records: round trips, and times of one way.
struct Measured {
    begun: Option<Instant>,
    round_trip: Latencies,
    state: Latencies,
    setpoint: Latencies,
}

impl Measured {
    fn take(&mut self, frame: Frame, now_ns: u64) {
        let begun = *self.begun.get_or_insert_with(Instant::now);
        if begun.elapsed() < WARM_UP || frame.echo_sent_ns == 0 {
            return;
        }
        self.round_trip.record(now_ns.saturating_sub(frame.echo_sent_ns + frame.echo_held_ns));
        self.state.record(now_ns.saturating_sub(frame.sent_ns));
        self.setpoint.record(frame.echo_transit_ns);
    }
}

fn other(kind: &str, address: &str, time: Duration) -> Value {
    let newest = Newest::default();
    let new = Latencies::new;
    let measured =
        Arc::new(Mutex::new(Measured { begun: None, round_trip: new(), state: new(), setpoint: new() }));
    let (of_receiver, of_measuring) = (Arc::clone(&newest), Arc::clone(&measured));
    let take: Take = Box::new(move |bytes| {
        let now = now_ns();
        set(&of_receiver, bytes, now);
        if let Some(frame) = Frame::read(bytes) {
            of_measuring.lock().expect("no thread panicked").take(frame, now);
        }
    });
    let send = match kind {
        "udp" => over_udp(UdpSocket::bind("0.0.0.0:0").expect("a free port"), address.parse().ok(), take),
        _ => over_zenoh(
            &open("client", "connect", address),
            ["baseline/setpoint", "baseline/state"],
            Priority::RealTime,
            take,
        ),
    };
    let size = SETPOINT_HEAD + packed(setpoint());
    let ends = || {
        let begun = measured.lock().expect("no thread panicked").begun;
        begun.is_none_or(|begun| begun.elapsed() < WARM_UP + time)
    };
    send_at(SETPOINTS_HZ, size, &newest, send, ends);
    let measured = measured.lock().expect("no thread panicked");
    let (trip, state, setpoint) =
        (measured.round_trip.json(), measured.state.json(), measured.setpoint.json());
    json!({"round_trip_us": trip, "state_us": state, "setpoint_us": setpoint})
}

/// Returns how a frame is sent to `peer`, or to the newest sender.
fn over_udp(socket: UdpSocket, peer: Option<SocketAddr>, mut take: Take) -> Transmit {
    let peers = Arc::new(Mutex::new(peer));
    let (socket, of_receiver) = (Arc::new(socket), Arc::clone(&peers));
    let receiving = Arc::clone(&socket);
    std::thread::spawn(move || {
        let mut bytes = vec![0; 1 << 16];
        loop {
            // A peer that has ended is reported by the next call.
            let Ok((length, from)) = receiving.recv_from(&mut bytes) else { continue };
            *of_receiver.lock().expect("no thread panicked") = Some(from);
            take(&bytes[..length]);
        }
    });
    Box::new(move |bytes| {
        if let Some(peer) = *peers.lock().expect("no thread panicked") {
            let _dropped = socket.send_to(bytes, peer);
        }
    })
}

/// Returns a session without scouting, as that of motord-remote.
fn open(mode: &str, how: &str, address: &str) -> Session {
    let mut config = Config::default();
    let endpoint = json!([format!("udp/{address}")]);
    let none = json!([]);
    let (listen, connect) = if how == "listen" { (&endpoint, &none) } else { (&none, &endpoint) };
    for (key, value) in [
        ("mode", &json!(mode)),
        ("listen/endpoints", listen),
        ("connect/endpoints", connect),
        ("scouting/multicast/enabled", &json!(false)),
        ("scouting/gossip/enabled", &json!(false)),
    ] {
        config.insert_json5(key, &value.to_string()).expect("a key of zenoh");
    }
    zenoh::open(config).wait().expect("a session")
}

/// Sends by the first key and receives by the second, with the settings of motord-remote.
fn over_zenoh(
    session: &Session,
    [sent, received]: [&'static str; 2],
    priority: Priority,
    take: Take,
) -> Transmit {
    let take = Mutex::new(take);
    session
        .declare_subscriber(received)
        .callback(move |sample| take.lock().expect("no thread panicked")(&sample.payload().to_bytes()))
        .background()
        .wait()
        .expect("a subscriber");
    let publisher = session.declare_publisher(sent).congestion_control(CongestionControl::Drop);
    let publisher = publisher.priority(priority).reliability(Reliability::BestEffort).express(true);
    let publisher = publisher.wait().expect("a publisher");
    let session = session.clone();
    Box::new(move |bytes| {
        // The session lives as long as its publisher.
        let _session = &session;
        publisher.put(bytes).wait().expect("an open session");
    })
}

fn packed<T: motord_shared::plain::Sparse>(message: T) -> usize {
    let mut bytes = Vec::new();
    pack(&message, &mut bytes);
    bytes.len()
}

/// As config/quadruped-simulated.toml has.
fn state() -> StateMessage {
    StateMessage { joint_count: 12, group_count: 1, bus_count: 4, imu_count: 1, ..Default::default() }
}

fn setpoint() -> SetpointMessage {
    SetpointMessage { joint_count: 12, ..Default::default() }
}

/// Measures how much later a client of the mirror has the state of a cycle than a client of the robot.
fn states(robot: &str, other: &str, time: Duration) -> Value {
    let read = |path: &str| {
        let (runtime, instance) = path.rsplit_once('/').expect("RUNTIME/INSTANCE");
        let client = Client::connect_in(Path::new(runtime), instance).expect("a robot");
        std::thread::spawn(move || arrivals(&client, time))
    };
    let [robot, other] = [robot, other].map(read).map(|thread| thread.join().expect("no thread panicked"));
    let mut added = Latencies::new();
    for (cycle, at) in &other {
        if let Some(before) = robot.get(cycle) {
            added.record(at.saturating_sub(*before));
        }
    }
    added.json()
}

/// Returns when each cycle's state arrived, ns.
fn arrivals(client: &Client, time: Duration) -> HashMap<u64, u64> {
    let (begun, mut arrivals) = (Instant::now(), HashMap::new());
    while begun.elapsed() < time {
        if let Ok(state) = client.wait(Duration::from_secs(1)) {
            arrivals.insert(state.cycle(), now_ns());
        }
    }
    arrivals
}

fn counters(address: &str, name: &str) -> String {
    let session = open("client", "connect", address);
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(10) {
        let replies = session.get(format!("motord/{name}/link")).wait().expect("a query");
        while let Ok(reply) = replies.recv() {
            if let Ok(sample) = reply.result() {
                return String::from_utf8_lossy(&sample.payload().to_bytes()).into_owned();
            }
        }
        // A new session learns after a moment who answers.
        std::thread::sleep(Duration::from_millis(100));
    }
    panic!("no answer of {name}");
}
