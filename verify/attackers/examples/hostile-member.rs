//! A hostile member of the group that does not use its right to stop other members' motors.
//! `verify/rigs/test-malice` runs it.
//!
//! ```text
//! hostile-member INSTANCE GROUP ATTACK SECONDS
//! ```
//!
//! [`attack`] lists the attacks. Prints `begun` once one is active, and its actions in one line at
//! the end.

use iceoryx2::prelude::*;
use motord_client::Client;
use motord_harness::robot::fuzz_client::ABSURD;
use motord_ports::instance::{Instance, pid_namespace};
use motord_ports::service::Service;
use motord_ports::{ClientPorts, Payload, Question, SetpointPort, clock, stop_socket};
use motord_realtime::descriptors::raise_descriptors;
use motord_shared::limits::{JOINTS_MAX, RECORDERS_MAX, WATCHERS_MAX};
use motord_shared::message::{AdminAnswer, AdminReply, AdminRequest, CycleRecord, JointSetpoint};
use motord_shared::{Operation, SetpointMessage, StateMessage};
use nix::sys::socket::{SockFlag, connect};
use std::error::Error;
use std::hash::{BuildHasher, RandomState};
use std::io::Write;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

type Outcome<T> = Result<T, Box<dyn Error>>;

/// Messages per second of a flood.
const FLOOD_HZ: u64 = 20_000;
/// Messages per second of random values.
const VALUES_HZ: u64 = 2_000;
/// Limit on the connections.
const CONNECTIONS: usize = 1_000;
/// Slots for watchers that the attack leaves free.
const LEFT: usize = 6;
/// Longer than a request takes.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(1);
/// Clients of a flood of requests: each may have two open.
const REQUESTERS: usize = 10;
fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [instance, group, name, seconds] = &arguments[..] else { return Err("four arguments".into()) };
    let _raised = raise_descriptors()?;
    let length = Duration::from_secs(seconds.parse()?);
    println!("{name}: {}", attack(instance, group, name, length)?);
    Ok(())
}

/// Runs the attack `name` for `length`, and returns a description.
fn attack(instance: &str, group: &str, name: &str, length: Duration) -> Outcome<String> {
    match name {
        "values" => values(instance, group, length),
        "sizes" => sizes(instance, length),
        "setpoint-flood" => setpoint_flood(instance, group, length),
        "request-flood" => request_flood(instance, group, length),
        "connections" => connections(instance, length),
        "held" => held(instance, length),
        _ => Err("no such attack".into()),
    }
}

/// Reports that the attack is active. Returns its end.
fn begin(length: Duration) -> Instant {
    println!("begun");
    Instant::now() + length
}

/// A member that owns a group, as permitted.
struct Member {
    ports: ClientPorts,
    port: SetpointPort,
    random: Random,
    group: u32,
    groups: u32,
    joints: Vec<usize>,
    lease: u64,
    sequence: u64,
}

impl Member {
    fn new(instance: &str, group: &str) -> Outcome<Self> {
        let client = Client::connect(instance)?;
        let (index, robot) = (client.group_named(group)?, client.description());
        let ports = open(instance)?;
        Ok(Self {
            port: ports.setpoint_port()?,
            ports,
            random: Random::new(),
            group: u32::try_from(index)?,
            groups: u32::try_from(robot.groups.len())?,
            joints: robot.groups[index].joints.clone(),
            lease: 0,
            sequence: 0,
        })
    }

    /// Claims the group, and enables it if possible.
    fn seize(&mut self) -> Outcome<()> {
        self.ask(Operation::ForceRelease)?;
        self.lease = self.ask(Operation::Claim)?.lease;
        self.sequence = 0;
        for operation in [Operation::Reset, Operation::Enable] {
            let _refused_while_it_is_damped = self.ask(operation)?;
        }
        Ok(())
    }

    /// Sends a request, and holds the joints meanwhile.
    fn ask(&mut self, operation: Operation) -> Outcome<AdminReply> {
        let request = AdminRequest {
            lease: self.lease,
            operation: operation.code(),
            group: self.group,
            pid: std::process::id(),
            pid_namespace: if operation == Operation::Claim { pid_namespace() } else { 0 },
            ..Default::default()
        };
        let (question, begun) = (self.ports.ask(request)?, Instant::now());
        loop {
            if let Some((reply, _)) = question.answer()? {
                return Ok(reply);
            }
            if begun.elapsed() > REQUEST_TIMEOUT {
                return Ok(AdminReply::default());
            }
            self.hold()?;
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn hold(&mut self) -> Outcome<()> {
        if let Some(state) = self.ports.newest_state()? {
            let mut message = self.message();
            for (setpoint, &joint) in message.joints.iter_mut().zip(&self.joints) {
                let position = state.joints[joint].position;
                *setpoint = JointSetpoint { position, kp: 20.0, kd: 0.5, ..Default::default() };
            }
            self.port.send(&message)?;
        }
        Ok(())
    }

    /// Returns the numbers of accepted and of rejected setpoints of the group.
    fn verdicts(&self) -> Outcome<[u32; 2]> {
        let begun = Instant::now();
        while begun.elapsed() < REQUEST_TIMEOUT {
            if let Some(state) = self.ports.newest_state()? {
                let group = &state.groups()[self.group as usize];
                return Ok([
                    group.accepted,
                    group.rejected.iter().fold(0, |sum, count| sum.wrapping_add(*count)),
                ]);
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        Err("no state".into())
    }

    /// Returns a message with a valid lease, the next sequence number and the time.
    fn message(&mut self) -> SetpointMessage {
        self.sequence += 1;
        SetpointMessage {
            lease: self.lease,
            sequence: self.sequence,
            time_ns: clock::now_ns(),
            joint_count: self.joints.len() as u32,
            ..Default::default()
        }
    }

    /// Returns nonsense in each field of the setpoints. In half of the messages only the limits
    /// stop it. In a fourth of them the other fields are nonsense as well.
    fn nonsense(&mut self) -> SetpointMessage {
        let mut message = self.message();
        let random = &mut self.random;
        let is_believable = random.once_in(2);
        for setpoint in &mut message.joints {
            let [position, velocity, kp, kd, torque] =
                std::array::from_fn(|_| if is_believable { random.number() } else { random.value() });
            let mode = if random.once_in(4) && !is_believable { random.bits() as u32 } else { 0 };
            *setpoint = JointSetpoint { position, velocity, kp, kd, torque, mode };
            if is_believable {
                (setpoint.kp, setpoint.kd) = (kp.abs(), kd.abs());
            }
        }
        if random.once_in(4) {
            match random.bits() % 6 {
                0 => message.lease = random.bits(),
                1 => message.sequence = random.bits(),
                2 => message.time_ns = random.bits(),
                3 => message.joint_count = random.bits() as u32,
                4 => message.horizon_ns = random.bits() as u32,
                _ => message.cycle = random.bits(),
            }
        }
        message
    }

    /// Returns a request with nonsense in each field, except the permitted ones that would stop the
    /// robot.
    fn senseless(&mut self) -> AdminRequest {
        let random = &mut self.random;
        let code = if random.once_in(4) { random.bits() as u32 } else { (random.bits() % 20) as u32 };
        let of_others = [Operation::EmergencyStop, Operation::SetZero, Operation::ResetTelemetry];
        let is_of_others = of_others.iter().any(|operation| operation.code() == code);
        let joint = self.joints[random.bits() as usize % self.joints.len()] as u32;
        AdminRequest {
            lease: if random.once_in(2) { self.lease } else { random.bits() },
            operation: if is_of_others { Operation::Describe.code() } else { code },
            group: if random.once_in(2) { self.group } else { self.groups + random.bits() as u32 % 1000 },
            joint: if random.once_in(2) { joint } else { (JOINTS_MAX as u64 + random.bits() % 1000) as u32 },
            pid: random.bits() as u32,
            pid_namespace: random.bits(),
            argument: f64::from_bits(random.bits()),
        }
    }
}

/// Sends random values in every field of setpoints, with a valid lease, and of requests.
fn values(instance: &str, group: &str, length: Duration) -> Outcome<String> {
    let mut member = Member::new(instance, group)?;
    let (mut setpoints, mut requests) = (0, 0);
    let before = member.verdicts()?;
    let end = begin(length);
    while Instant::now() < end {
        member.seize()?;
        let until = end.min(Instant::now() + Duration::from_millis(500));
        paced(VALUES_HZ, until, |count| {
            let message = member.nonsense();
            setpoints += usize::from(member.port.send(&message).is_ok());
            if count.is_multiple_of(10) {
                let request = member.senseless();
                requests += usize::from(member.ports.ask(request).is_ok());
            }
        });
    }
    let [accepted, rejected] = member.verdicts()?;
    let [accepted, rejected] = [accepted.wrapping_sub(before[0]), rejected.wrapping_sub(before[1])];
    Ok(format!(
        "{setpoints} setpoints of random bits with valid leases, and {requests} requests; {accepted} setpoints accepted, {rejected} rejected"
    ))
}

fn setpoint_flood(instance: &str, group: &str, length: Duration) -> Outcome<String> {
    let mut member = Member::new(instance, group)?;
    member.seize()?;
    let (begun, end) = (Instant::now(), begin(length));
    let mut sent = 0_u32;
    paced(FLOOD_HZ, end, |_| sent += u32::from(member.hold_fast()));
    Ok(format!("{sent} setpoints, {:.0} a second", f64::from(sent) / begun.elapsed().as_secs_f64()))
}

impl Member {
    /// Holds the joints without reading the state.
    fn hold_fast(&mut self) -> bool {
        let mut message = self.message();
        for setpoint in &mut message.joints[..self.joints.len()] {
            setpoint.kd = 0.5;
        }
        self.port.send(&message).is_ok()
    }
}

fn request_flood(instance: &str, group: &str, length: Duration) -> Outcome<String> {
    let mut member = Member::new(instance, group)?;
    let requesters = (0..REQUESTERS).map(|_| open(instance)).collect::<Outcome<Vec<_>>>()?;
    let (mut sent, mut refused, begun, end) = (0_u32, 0_u32, Instant::now(), begin(length));
    let mut waiting: Vec<Option<Question>> = (0..2 * REQUESTERS).map(|_| None).collect();
    let mut next = 0;
    paced(FLOOD_HZ, end, |_| {
        next = (next + 1) % waiting.len();
        waiting[next] = None;
        waiting[next] = requesters[next / 2].ask(member.senseless()).ok();
        sent += u32::from(waiting[next].is_some());
        refused += u32::from(waiting[next].is_none());
    });
    let rate = f64::from(sent) / begun.elapsed().as_secs_f64();
    Ok(format!("{sent} requests, {rate:.0} a second, and {refused} rejected by iceoryx2"))
}

/// Opens the maximum number of clients in a thousand attempts. Opens as many connections to the
/// socket for emergency stops without a request.
fn connections(instance: &str, length: Duration) -> Outcome<String> {
    let address = stop_socket::address(&Instance::find(instance)?)?;
    let (mut clients, mut sockets, mut refused) = (Vec::new(), Vec::<OwnedFd>::new(), 0);
    for _ in 0..CONNECTIONS {
        match open(instance) {
            Ok(client) => clients.push(client),
            Err(_) => refused += 1,
        }
        let socket = stop_socket::open(SockFlag::SOCK_NONBLOCK)?;
        if connect(socket.as_raw_fd(), &address).is_ok() {
            sockets.push(socket);
        }
        // Leaves slots for other clients.
        clients.truncate(16);
    }
    begin(length);
    std::thread::sleep(length);
    let (held, silent) = (clients.len(), sockets.len());
    Ok(format!(
        "{CONNECTIONS} clients, {refused} refused, {held} kept; {silent} silent connections for a stop"
    ))
}

/// Keeps received samples, does not read its answers, and does not send borrowed samples.
fn held(instance: &str, length: Duration) -> Outcome<String> {
    let node = node(instance)?;
    let states = node
        .service_builder(&service(instance, "state")?)
        .publish_subscribe::<Payload<StateMessage>>()
        .open()?;
    let records = node
        .service_builder(&service(instance, "record")?)
        .publish_subscribe::<Payload<CycleRecord>>()
        .open()?;
    let setpoints = node
        .service_builder(&service(instance, "setpoint")?)
        .publish_subscribe::<Payload<SetpointMessage>>()
        .open()?;
    let admin = node
        .service_builder(&service(instance, "admin")?)
        .request_response::<Payload<AdminRequest>, Payload<AdminAnswer>>()
        .open()?;
    let watchers = (0..WATCHERS_MAX - LEFT)
        .map(|_| states.subscriber_builder().create())
        .collect::<Result<Vec<_>, _>>()?;
    let recorders =
        (0..RECORDERS_MAX).map(|_| records.subscriber_builder().create()).collect::<Result<Vec<_>, _>>()?;
    let sender = setpoints.publisher_builder().create()?;
    let _borrowed = sender.loan_uninit()?;
    let requester = admin.client_builder().create()?;
    let (mut kept_states, mut kept_records, mut unread) = (Vec::new(), Vec::new(), Vec::new());
    let end = begin(length);
    while Instant::now() < end {
        kept_states.extend(watchers.iter().filter_map(|watcher| watcher.receive().ok().flatten()));
        kept_records.extend(recorders.iter().filter_map(|recorder| recorder.receive().ok().flatten()));
        let request = AdminRequest { operation: Operation::Describe.code(), ..Default::default() };
        unread.extend(requester.send_copy(Payload(request)).ok());
        std::thread::sleep(Duration::from_millis(1));
    }
    let counts = (kept_states.len(), kept_records.len(), unread.len());
    Ok(format!("{} states, {} records and {} answers, never released", counts.0, counts.1, counts.2))
}

/// Opens the services' names with other layouts, and sends messages of any length to every socket
/// of the directory.
fn sizes(instance: &str, length: Duration) -> Outcome<String> {
    let mut random = Random::new();
    let found = Instance::find(instance)?;
    let node = node(instance)?;
    let (mut refused, mut beside, mut messages) = (0, 0, 0);
    let end = begin(length);
    while Instant::now() < end {
        for part in ["state", "record", "setpoint", "cycle", "admin"] {
            for opened in other_layouts(&node, &service(instance, part)?) {
                refused += usize::from(!opened);
                beside += usize::from(opened);
            }
        }
        messages += sockets(found.runtime()).iter().map(|path| disturb(path, &random.bytes())).sum::<usize>();
        std::thread::sleep(Duration::from_millis(5));
    }
    Ok(format!(
        "{refused} other layouts refused, {beside} services of another kind beside them; {messages} messages into sockets"
    ))
}

/// Tries to open or create the services of this name with five foreign layouts. Returns the
/// successes.
fn other_layouts(node: &Node<Service>, name: &ServiceName) -> [bool; 5] {
    let builder = || node.service_builder(name);
    [
        builder().publish_subscribe::<u64>().open_or_create().is_ok(),
        builder().publish_subscribe::<[u8]>().open_or_create().is_ok(),
        builder()
            .publish_subscribe::<Payload<SetpointMessage>>()
            .max_publishers(200)
            .open_or_create()
            .is_ok(),
        builder().request_response::<u64, u64>().open_or_create().is_ok(),
        builder().event().event_id_max_value(1000).open_or_create().is_ok(),
    ]
}

/// Sends a datagram and a stream. Returns the number of accepted messages.
fn disturb(path: &Path, bytes: &[u8]) -> usize {
    let datagram = UnixDatagram::unbound().and_then(|socket| {
        socket.set_nonblocking(true)?;
        socket.send_to(bytes, path)
    });
    let stream = UnixStream::connect(path).and_then(|mut socket| {
        socket.set_nonblocking(true)?;
        socket.write(bytes)
    });
    usize::from(datagram.is_ok()) + usize::from(stream.is_ok())
}

fn sockets(directory: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(directory).into_iter().flatten().flatten() {
        match entry.file_type() {
            Ok(kind) if kind.is_dir() => found.extend(sockets(&entry.path())),
            Ok(kind) if kind.is_socket() => found.push(entry.path()),
            _ => {}
        }
    }
    found
}

fn open(instance: &str) -> Outcome<ClientPorts> {
    let attachment = Instance::find(instance)?.attach()?.ok_or("no daemon")?;
    Ok(ClientPorts::open(attachment)?)
}

/// Creates a node like the daemon's clients, without their code.
fn node(instance: &str) -> Outcome<Node<Service>> {
    let root = Instance::find(instance)?.runtime().join("iox").join(instance);
    let mut config = Config::default();
    config.global.set_root_path(&iceoryx2::prelude::Path::new(root.as_os_str().as_bytes())?);
    config.global.prefix = FileName::new(b"m_")?;
    set_log_level(LogLevel::Fatal);
    Ok(NodeBuilder::new()
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .config(&config)
        .create::<Service>()?)
}

fn service(instance: &str, part: &str) -> Outcome<ServiceName> {
    Ok(ServiceName::new(&format!("motord/{instance}/{part}"))?)
}

/// Calls `act` with its number `hz` times per second, in bursts of a millisecond, until `end`.
fn paced(hz: u64, end: Instant, mut act: impl FnMut(u64)) {
    let begun = Instant::now();
    let mut count = 0;
    while Instant::now() < end {
        let due = begun.elapsed().as_micros() as u64 * hz / 1_000_000;
        while count < due {
            act(count);
            count += 1;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Splitmix64.
struct Random(u64);

impl Random {
    fn new() -> Self {
        Self(RandomState::new().hash_one(0))
    }

    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ mixed >> 31
    }

    fn once_in(&mut self, times: u64) -> bool {
        self.bits().is_multiple_of(times)
    }

    /// Returns any bits, an absurd number, or a plausible one.
    fn value(&mut self) -> f32 {
        match self.bits() % 3 {
            0 => f32::from_bits(self.bits() as u32),
            1 => ABSURD[self.bits() as usize % ABSURD.len()],
            _ => self.number(),
        }
    }

    /// Returns a plausible number, or a far larger one.
    fn number(&mut self) -> f32 {
        let most = [1.0, 30.0, 1e3, f32::MAX / 2.0][self.bits() as usize % 4];
        (self.bits() % 2001) as f32 / 1e3 * most - most
    }

    /// Returns at most 64 KiB.
    fn bytes(&mut self) -> Vec<u8> {
        let length = if self.once_in(2) { self.bits() % 64 } else { self.bits() % (1 << 16) };
        (0..length).map(|_| self.bits() as u8).collect()
    }
}
