//! The instance of this computer: the daemon's ports, with a robot behind the network.

use super::imus::{Imus, has_external};
use super::records::Records;
use super::requests::{self, Requests, extended, refuse};
use super::stop_socket;
use super::wire::{BEAT, Sender, Wire};
use crate::network::NetworkError;
use motord_ports::instance::pid_namespace;
use motord_ports::{
    DaemonPorts, Housekeeper, ImuReceiver, Instance, InstanceError, InstanceLock, Request, ServiceError,
};
use motord_realtime::process::{Deaths, Watched, deaths};
use motord_shared::limits::GROUPS_MAX;
use motord_shared::{AdminRequest, Lease, Operation, Refusal, SetpointMessage, StateMessage};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Interval of the checks for setpoints while a client of this computer owns a group.
const OWNED_POLL: Duration = Duration::from_micros(200);
/// The same without owners: for requests.
const IDLE_POLL: Duration = Duration::from_millis(2);
/// Interval of the checks for clients that have died.
const CLEAN: Duration = Duration::from_secs(1);
/// Between two lines about lost states.
const REPORT: Duration = Duration::from_secs(10);
/// Requests taken in a turn.
const REQUESTS_PER_TURN: usize = 64;

/// The reason why the instance cannot be served.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MirroredError {
    #[error(transparent)]
    Instance(#[from] InstanceError),
    #[error(transparent)]
    Service(#[from] ServiceError),
    #[error("cannot watch the processes of owners: {0}")]
    Owners(#[from] nix::errno::Errno),
}

/// The instance, for one run of the robot's daemon.
pub(super) struct Mirrored {
    wire: Arc<Wire>,
    ports: DaemonPorts,
    /// `None` for a robot without an external IMU.
    imus: Option<ImuReceiver>,
    housekeeper: Option<Housekeeper>,
    description: Vec<u8>,
    requests: Requests,
    /// By group, the lease of a client of this computer.
    leases: [Option<Lease>; GROUPS_MAX],
    owners: Watched,
    deaths: Deaths,
    ends: Arc<AtomicBool>,
    /// The thread of the stop socket.
    stops: Option<JoinHandle<()>>,
    // Dropped last.
    lock: InstanceLock,
}

impl Mirrored {
    pub(super) fn open(
        instance: &str,
        wire: &Arc<Wire>,
        description: Vec<u8>,
    ) -> Result<Self, MirroredError> {
        let lock = Instance::find(instance)?.lock()?;
        let ports = DaemonPorts::open(&lock)?;
        let imus = has_external(&description).then(|| ports.open_imus(&lock)).transpose()?;
        let (owners, deaths) = deaths(GROUPS_MAX)?;
        let ends = Arc::new(AtomicBool::new(false));
        let stops = stop_socket::start(lock.instance(), Arc::clone(wire), Arc::clone(&ends));
        Ok(Self {
            wire: Arc::clone(wire),
            ports,
            imus,
            housekeeper: Housekeeper::open(&lock).ok(),
            description,
            requests: Requests::new(Arc::clone(wire)),
            leases: [None; GROUPS_MAX],
            owners,
            deaths,
            ends,
            stops: Some(stops),
            lock,
        })
    }

    /// Serves clients until `ends`, or until the robot's daemon is another one than that of `first`.
    pub(super) fn run(&mut self, first: &StateMessage, ends: &AtomicBool) -> Result<(), NetworkError> {
        let wire = Arc::clone(&self.wire);
        let setpoints = wire.sender(wire.keys.setpoint())?;
        let beats = wire.sender(wire.keys.beat())?;
        let mut imus = Imus::new(&wire, first.boot_id)?;
        let mut records = Records::new(&wire, self.ports.recorders().clone(), first.boot_id)?;
        self.publish(first);
        let mut beaten = Instant::now();
        let mut chores = Chores::new(&wire);
        while !ends.load(Ordering::Relaxed) {
            if let Some(state) = self.wire.newest() {
                if state.boot_id != first.boot_id {
                    tracing::warn!("motord on the robot was restarted");
                    break;
                }
                self.publish(&state);
            }
            if self.pass_setpoints(&setpoints) {
                beaten = Instant::now();
            } else if beaten.elapsed() >= BEAT {
                beaten = Instant::now();
                beats.put(self.wire.up().beat());
            }
            if let Some(receiver) = &self.imus {
                imus.pass(receiver);
            }
            records.turn();
            self.serve_requests();
            chores.turn(&wire, self.housekeeper.as_ref());
            let is_owned = self.leases.iter().any(Option::is_some);
            std::thread::park_timeout(if is_owned { OWNED_POLL } else { IDLE_POLL });
        }
        self.leave();
        Ok(())
    }

    fn publish(&mut self, state: &StateMessage) {
        // A damaged connection must not keep other clients asleep.
        let _damaged = self.ports.publish(state).and(self.ports.notify());
        self.ports.prepare();
    }

    /// Passes the newest setpoints of each owner on. Returns whether there were any.
    fn pass_setpoints(&self, sender: &Sender<'_>) -> bool {
        let mut newest: [Option<SetpointMessage>; GROUPS_MAX] = [None; GROUPS_MAX];
        let _damaged = self.ports.take_setpoint(|message| {
            let Some(lease) = Lease::from_raw(message.lease) else { return };
            if self.leases[lease.group()] == Some(lease) {
                newest[lease.group()] = Some(*message);
            }
        });
        for message in newest.iter().flatten() {
            let up = self.wire.up();
            let age = up.head.sent_ns.saturating_sub(message.time_ns);
            sender.put(up.with_setpoint(message, Duration::from_nanos(age)));
        }
        newest.iter().any(Option::is_some)
    }

    fn serve_requests(&mut self) {
        for _ in 0..REQUESTS_PER_TURN {
            let Ok(Some(request)) = self.ports.next_request() else { break };
            self.serve(request);
        }
        self.requests.retry();
        while let Some((request, answer)) = self.requests.answered() {
            let payload = *request.payload();
            let operation = payload.operation();
            let granted = answer.as_ref().and_then(|(head, _)| Lease::from_raw(head.lease));
            granted.into_iter().for_each(|lease| self.own(lease, &payload));
            let answer = operation.map_or(None, |operation| extended(&self.wire, operation, answer));
            let is_answered = requests::reply(request, answer);
            // A client that has given up knows no lease, so it cannot release the group.
            granted.filter(|_| !is_answered).into_iter().for_each(|lease| self.release(lease));
        }
        while let Some(lease) = self.deaths.next(Duration::ZERO).and_then(Lease::from_raw) {
            self.owner_ended(lease);
        }
    }

    fn serve(&mut self, request: Request) {
        let payload = *request.payload();
        match payload.operation() {
            Ok(Operation::Describe) => {
                let _disconnected = request.reply(motord_shared::AdminReply::default(), &self.description);
            }
            // A stop goes on without the network's queue of requests.
            Ok(Operation::EmergencyStop) => self.requests.pass(request),
            Ok(_) if self.wire.time_since_state() > Duration::from_secs(1) => refuse(request, Refusal::Busy),
            operation => {
                if operation == Ok(Operation::ResetTelemetry) {
                    self.wire.latencies.reset();
                }
                if let (Ok(Operation::Release), Some(lease)) = (operation, Lease::from_raw(payload.lease)) {
                    self.leases[lease.group()] = None;
                    self.owners.forget(lease.group());
                }
                self.requests.pass(request);
            }
        }
    }

    /// Notes the owner of a group, and watches its process.
    fn own(&mut self, lease: Lease, request: &AdminRequest) {
        self.leases[lease.group()] = Some(lease);
        let namespace = pid_namespace();
        if namespace != 0 && request.pid_namespace == namespace {
            if self.owners.watch(lease.group(), request.pid, lease.raw()) {
                self.owner_ended(lease);
            }
        } else {
            self.owners.forget(lease.group());
        }
    }

    /// Releases the group of an owner whose process has ended: the daemon damps it.
    fn owner_ended(&mut self, lease: Lease) {
        if self.leases[lease.group()] == Some(lease) {
            tracing::warn!(group = lease.group(), "the process of the owner has ended");
            self.release(lease);
        }
    }

    fn release(&mut self, lease: Lease) {
        self.leases[lease.group()] = None;
        let operation = Operation::Release.code();
        let request = AdminRequest {
            lease: lease.raw(),
            operation,
            group: lease.group() as u32,
            ..AdminRequest::default()
        };
        requests::release(&self.wire, &request);
    }

    /// Releases all groups of this computer's clients.
    fn leave(&mut self) {
        for lease in self.leases.into_iter().flatten() {
            self.release(lease);
        }
        // The next instance needs its socket.
        self.ends.store(true, Ordering::Relaxed);
        let _panicked = self.stops.take().map(JoinHandle::join);
        // Its motors are those of the daemon on the robot.
        self.lock.rest();
    }
}

/// The tasks of the main loop that have an interval.
struct Chores {
    cleaned: Instant,
    reported: Instant,
    losses: [u64; 3],
}

impl Chores {
    fn new(wire: &Wire) -> Self {
        Self { cleaned: Instant::now(), reported: Instant::now(), losses: wire.losses() }
    }

    fn turn(&mut self, wire: &Wire, housekeeper: Option<&Housekeeper>) {
        if self.cleaned.elapsed() >= CLEAN {
            self.cleaned = Instant::now();
            let _removed = housekeeper.map(Housekeeper::clean);
        }
        if self.reported.elapsed() >= REPORT {
            self.reported = Instant::now();
            self.losses = report(self.losses, wire.losses());
        }
    }
}

/// Logs the states and records that were lost, and the frames that did not count, since `before`.
fn report(before: [u64; 3], now: [u64; 3]) -> [u64; 3] {
    // A reset begins anew.
    let since = |index: usize| now[index].checked_sub(before[index]).unwrap_or(now[index]);
    let [lost, lost_records, refused] = [0, 1, 2].map(since);
    if lost + refused > 0 {
        tracing::warn!(lost, refused, "states of the robot were lost, or did not count");
    }
    if lost_records > 0 {
        tracing::warn!(lost = lost_records, "records of the robot were lost");
    }
    now
}
