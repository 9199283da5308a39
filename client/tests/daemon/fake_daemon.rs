//! A fake daemon that consists of ports only.

use super::INSTANCE;
use motord_ports::{DaemonPorts, Housekeeper, Instance, Request, clock};
use motord_shared::description::{GroupDescription, JointDescription, RobotDescription, Telemetry};
use motord_shared::message::{
    AdminReply, GroupState, JOINT_VALID, JointState, SetpointMessage, StateMessage,
};
use motord_shared::{Cause, Lease, MotorMode, Operation, Phase, Refusal};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// More than the kernel gives to a process: the daemon may be in a container, where its id means
/// another process or none.
const NO_PROCESS: u32 = 1 << 22 | 1;

/// The daemon of a test: it serves the client, and records the received setpoints.
pub(crate) struct FakeDaemon {
    ports: DaemonPorts,
    boot_id: u64,
    cycle: u64,
    owner: u64,
    epoch: u32,
    sequence: u64,
    seen: Arc<Mutex<Vec<SetpointMessage>>>,
    silent: Arc<AtomicBool>,
    /// The second joint sends no replies.
    mute: Arc<AtomicBool>,
    /// The second joint is excluded.
    excluded: Arc<AtomicBool>,
    /// Code of the latched cause, for the second joint.
    cause: Arc<AtomicU32>,
    phase: Phase,
    /// Requests without an answer.
    held: Vec<Request>,
    /// The rate in the description; the fake daemon always runs at 1 kHz.
    rate_hz: f64,
}

impl FakeDaemon {
    /// Serves requests before it reads setpoints: a client must not rely on the order it sent them
    /// in.
    fn cycle(&mut self, joint_count: u32) {
        self.cycle += 1;
        while let Some(request) = self.ports.next_request().unwrap() {
            if request.payload().operation == Operation::ClearFault.code() {
                self.held.push(request);
                continue;
            }
            let (reply, text) = self.answer(request.payload().operation, request.payload().lease);
            let _ = request.reply(reply, &text);
        }
        let take = |setpoint: &SetpointMessage| {
            self.sequence = setpoint.sequence;
            self.seen.lock().unwrap().push(*setpoint);
        };
        self.ports.take_setpoint(take).unwrap();
        if self.silent.load(Ordering::Relaxed) {
            return;
        }
        self.advance_phase();
        self.ports.publish(&self.state(joint_count)).unwrap();
        self.ports.notify().unwrap();
    }

    /// As the daemon, takes the started group from an owner whose setpoints stayed away. The test
    /// decides when.
    fn advance_phase(&mut self) {
        let is_late = self.cause.load(Ordering::Relaxed) == Cause::SetpointTimeout.code();
        if is_late && self.phase != Phase::Disarmed {
            self.owner = 0;
        }
        self.phase = match self.phase {
            _ if self.cause.load(Ordering::Relaxed) != 0 => Phase::Disarmed,
            Phase::Starting if self.cycle.is_multiple_of(5) => Phase::Active,
            phase => phase,
        };
    }

    fn state(&self, joint_count: u32) -> StateMessage {
        let mut state = StateMessage {
            boot_id: self.boot_id,
            cycle: self.cycle,
            tick_ns: clock::now_ns(),
            publish_ns: clock::now_ns(),
            joint_count,
            group_count: 1,
            ..StateMessage::default()
        };
        for (index, joint) in state.joints.iter_mut().enumerate() {
            let is_reported = index != 1 || !self.mute.load(Ordering::Relaxed);
            let (position, flags) =
                if is_reported { (0.5 + index as f32, JOINT_VALID) } else { (f32::NAN, 0) };
            let is_excluded = index == 1 && self.excluded.load(Ordering::Relaxed);
            let mode = if is_excluded { MotorMode::Excluded } else { MotorMode::Idle }.code();
            let receive_ns = if is_reported { clock::now_ns() } else { 0 };
            *joint = JointState { position, flags, mode, receive_ns, ..JointState::default() };
        }
        state.groups[0] = GroupState {
            lease: self.owner,
            sequence: self.sequence,
            phase: self.phase.code(),
            cause: self.cause.load(Ordering::Relaxed),
            cause_joint: 1,
            ..GroupState::default()
        };
        state
    }

    fn answer(&mut self, operation: u32, lease: u64) -> (AdminReply, Vec<u8>) {
        let done = AdminReply::default();
        match Operation::try_from(operation) {
            Ok(Operation::Describe) => (done, serde_json::to_vec(&self.description()).unwrap()),
            Ok(Operation::Telemetry) => (done, serde_json::to_vec(&Telemetry::default()).unwrap()),
            Ok(Operation::Claim) if self.owner == 0 => {
                self.epoch += 1;
                self.sequence = 0;
                self.owner = granted(self.boot_id, self.epoch);
                (AdminReply { lease: self.owner, ..done }, vec![])
            }
            Ok(Operation::Claim) => {
                (AdminReply { refusal: Refusal::Owned.code(), detail: 4321, ..done }, vec![])
            }
            Ok(Operation::Release) if lease == self.owner => {
                self.owner = 0;
                (done, vec![])
            }
            Ok(Operation::Release) => (AdminReply { refusal: Refusal::NotOwner.code(), ..done }, vec![]),
            Ok(Operation::ForceRelease) => {
                self.owner = 0;
                (done, vec![])
            }
            Ok(Operation::Enable) if self.sequence == 0 => {
                (AdminReply { refusal: Refusal::NoSetpoint.code(), ..done }, vec![])
            }
            Ok(Operation::Enable) if lease == self.owner => {
                self.phase = Phase::Starting;
                (done, vec![])
            }
            Ok(Operation::Disable) => {
                self.phase = Phase::Disarmed;
                (done, vec![])
            }
            Ok(Operation::EmergencyStop) => (done, vec![]),
            _ => (AdminReply { refusal: Refusal::Busy.code(), ..done }, vec![]),
        }
    }

    fn description(&self) -> RobotDescription {
        let joint = |name: &str| JointDescription { name: name.into(), ..JointDescription::default() };
        RobotDescription {
            pid: NO_PROCESS,
            boot_id: self.boot_id,
            rate_hz: self.rate_hz,
            setpoint_timeout: Duration::from_millis(20),
            setpoint_horizon_max: Duration::from_millis(40),
            joints: vec![joint("hip"), joint("knee")],
            groups: vec![GroupDescription { name: "leg".into(), joints: vec![0, 1] }],
            ..RobotDescription::default()
        }
    }
}

pub(crate) fn granted(boot_id: u64, epoch: u32) -> u64 {
    Lease::new(boot_id, epoch, 0).unwrap().raw()
}

/// Interval of the cleanup after dead clients: four times a second.
pub(crate) const CLEANING_CYCLES: u64 = 250;

/// A fake daemon on a separate thread, until it is dropped.
pub(crate) struct Running {
    stop: Arc<AtomicBool>,
    /// Publishes no states; all other work continues.
    pub(crate) silent: Arc<AtomicBool>,
    pub(crate) mute: Arc<AtomicBool>,
    pub(crate) excluded: Arc<AtomicBool>,
    pub(crate) cause: Arc<AtomicU32>,
    pub(crate) seen: Arc<Mutex<Vec<SetpointMessage>>>,
    thread: Option<JoinHandle<()>>,
}

impl Running {
    pub(crate) fn start(runtime: &Path, boot_id: u64) -> Self {
        Self::start_with(runtime, boot_id, 2, 1000.0)
    }

    pub(crate) fn start_with(runtime: &Path, boot_id: u64, joint_count: u32, rate_hz: f64) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let (seen, silent) = (Arc::default(), Arc::<AtomicBool>::default());
        let (mute, excluded) = (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default());
        let cause = Arc::<AtomicU32>::default();
        let (running, runtime) = (Arc::new(AtomicBool::new(false)), runtime.to_owned());
        let thread = std::thread::spawn({
            let (stop, seen, running) = (Arc::clone(&stop), Arc::clone(&seen), Arc::clone(&running));
            let (silent, mute) = (Arc::clone(&silent), Arc::clone(&mute));
            let (excluded, cause) = (Arc::clone(&excluded), Arc::clone(&cause));
            move || {
                let lock = Instance::below(&runtime, INSTANCE).unwrap().lock().unwrap();
                let ports = DaemonPorts::open(&lock).unwrap();
                let housekeeper = Housekeeper::open(&lock).unwrap();
                let mut daemon = FakeDaemon {
                    ports,
                    boot_id,
                    cycle: 0,
                    owner: 0,
                    epoch: 0,
                    sequence: 0,
                    seen,
                    silent,
                    mute,
                    excluded,
                    cause,
                    phase: Phase::Disarmed,
                    held: vec![],
                    rate_hz,
                };
                let mut tick = Instant::now();
                while !stop.load(Ordering::Relaxed) {
                    daemon.cycle(joint_count);
                    if daemon.cycle.is_multiple_of(CLEANING_CYCLES) {
                        let _removed = housekeeper.clean();
                    }
                    running.store(true, Ordering::Relaxed);
                    tick = Instant::now().max(tick + Duration::from_millis(1));
                    std::thread::sleep(tick.saturating_duration_since(Instant::now()));
                }
            }
        });
        while !running.load(Ordering::Relaxed) && !thread.is_finished() {
            std::thread::sleep(Duration::from_millis(1));
        }
        Self { stop, silent, mute, excluded, cause, seen, thread: Some(thread) }
    }

    pub(crate) fn setpoints(&self) -> Vec<SetpointMessage> {
        self.seen.lock().unwrap().clone()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap();
    }
}
