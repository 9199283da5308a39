//! The connection to the daemon that a [`Client`](crate::Client) and its claims share.
//!
//! | lock | held |
//! |---|---|
//! | `view` | while a state is processed, microseconds |
//! | `robot` | while a pointer is copied |
//! | `ordinary` | while an ordinary request runs, a second at most |
//! | `stop` | while an emergency stop runs, a second at most |
//!
//! A thread that sleeps until the next state holds no lock. Sending a setpoint waits only for
//! `robot`: it only tries `view`, which a spinning thread holds most of the time. An emergency stop
//! waits only for another emergency stop.
//!
//! In a forked process a lock may be held by a thread that does not exist there. Therefore each
//! function takes the ports, which are refused there, before any lock.

use crate::error::{Error, Stop};
use crate::imu::Imu;
use crate::state::Group;
use crate::view::{View, nanos};
use motord_ports::instance::{Attachment, pid_namespace};
use motord_ports::service::{Obstacle, ServiceError};
use motord_ports::stop_socket::{StopError, StopPath};
use motord_ports::{
    ClientPorts, ForkGuard, ImuSender, Instance, RecordPort, SetpointPort, StateEvents, clock, liveness,
};
use motord_shared::description::RobotDescription;
use motord_shared::limits::JOINTS_MAX;
use motord_shared::message::AdminReply;
use motord_shared::{AdminRequest, Lease, Operation, Phase};
use serde::de::DeserializeOwned;
use std::ops::ControlFlow;
use std::os::fd::{AsFd as _, BorrowedFd};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, TryLockError};
use std::time::{Duration, Instant};

/// Longest time to wait for an answer. The daemon answers within a cycle or two; the rest allows
/// for stalls of the machine.
pub(crate) const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);

/// Interval at which a request checks for its answer: well below a cycle.
const ANSWER_POLL: Duration = Duration::from_micros(200);

/// Number of checks for a first state, to report the position of a refused joint.
const POSITION_TRIES: u32 = 5;

/// Shortest time without a state after which the daemon counts as silent, in cycles and as a time.
const SILENCE_CYCLES: f64 = 5.0;
const SILENCE_MIN: Duration = Duration::from_millis(50);

/// The lease, group, joint and argument of a request.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Subject {
    pub(crate) lease: Option<Lease>,
    pub(crate) group: usize,
    pub(crate) joint: usize,
    pub(crate) argument: f64,
}

impl Subject {
    fn request(self, operation: Operation) -> AdminRequest {
        let index = |index: usize| u32::try_from(index).unwrap_or(u32::MAX);
        AdminRequest {
            lease: self.lease.map_or(0, Lease::raw),
            operation: operation.code(),
            group: index(self.group),
            joint: index(self.joint),
            pid: std::process::id(),
            pid_namespace: pid_namespace(),
            argument: self.argument,
        }
    }
}

/// The ports, the description of the robot, and the newest state.
#[derive(Debug)]
pub(crate) struct Connection {
    instance: Instance,
    ports: ForkGuard<ClientPorts>,
    /// Found beforehand: a signal handler may use it.
    stop_path: Result<StopPath, StopError>,
    /// Empty until the caller wants a file descriptor.
    events: OnceLock<ForkGuard<StateEvents>>,
    view: Mutex<View>,
    /// The description from the daemon whose states arrive. A restart replaces it, with another
    /// boot id.
    robot: Mutex<Arc<RobotDescription>>,
    /// The boot id of `robot`, for the comparison in every cycle without a lock.
    boot_id: AtomicU64,
    ordinary: Mutex<()>,
    stop: Mutex<()>,
    /// Number of the newest state's cycle.
    cycle: AtomicU64,
    /// Number of the cycle whose state was last given to the caller.
    taken: AtomicU64,
    /// Time of the last received state, ns of `CLOCK_MONOTONIC`. Before the first state: time of
    /// the first check for one, or 0.
    last_state_ns: AtomicU64,
    /// Longest time without a state that is no error, ns: set by the caller, or 0 for the default.
    silence_ns: AtomicU64,
    default_silence_ns: AtomicU64,
}

/// The number of states that a thread reads at a time.
#[derive(Debug, Clone, Copy)]
enum Wanted {
    /// Every state that has arrived: the last may come from another daemon.
    All,
    /// One state of the known daemon.
    One,
}

impl Connection {
    /// Connects to the daemon of `instance`, over the ports that `open` returns.
    pub(crate) fn open(
        instance: Instance,
        open: fn(Attachment) -> Result<ClientPorts, ServiceError>,
    ) -> Result<Self, Error> {
        let attachment = instance.attach().map_err(Error::of_instance)?;
        let attachment = attachment.ok_or_else(|| Error::not_running(&instance))?;
        let ports =
            ForkGuard::open(|| open(attachment)).map_err(|error| Error::of_service(error, &instance))?;
        let stop_path = StopPath::of(&instance).map_err(StopError::System);
        let link = Self {
            instance,
            ports,
            stop_path,
            events: OnceLock::new(),
            view: Mutex::default(),
            robot: Mutex::default(),
            boot_id: AtomicU64::new(0),
            ordinary: Mutex::default(),
            stop: Mutex::default(),
            cycle: AtomicU64::new(0),
            taken: AtomicU64::new(0),
            last_state_ns: AtomicU64::new(0),
            silence_ns: AtomicU64::new(0),
            default_silence_ns: AtomicU64::new(nanos(SILENCE_MIN)),
        };
        link.read_description()?;
        Ok(link)
    }

    /// Processes the states that have arrived, and returns the newest. After a state of another
    /// daemon, first reads the description of the robot, which may take up to [`ANSWER_TIMEOUT`].
    pub(crate) fn poll(&self) -> Result<MutexGuard<'_, View>, Error> {
        let ports = self.ports.get()?;
        self.take_in(ports, locked(&self.view), Wanted::All)
    }

    /// Works like [`poll`](Self::poll), but stops after one state of the known daemon.
    pub(crate) fn glance(&self) -> Result<MutexGuard<'_, View>, Error> {
        let ports = self.ports.get()?;
        self.take_in(ports, locked(&self.view), Wanted::One)
    }

    /// Works like [`poll`](Self::poll), but skips when another thread holds the view.
    pub(crate) fn refresh(&self) -> Result<(), Error> {
        let ports = self.ports.get()?;
        self.try_view().map_or(Ok(()), |view| self.take_in(ports, view, Wanted::All).map(drop))
    }

    fn try_view(&self) -> Option<MutexGuard<'_, View>> {
        match self.view.try_lock() {
            Ok(view) => Some(view),
            Err(TryLockError::Poisoned(view)) => Some(view.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    fn take_in<'a>(
        &'a self,
        ports: &ClientPorts,
        mut view: MutexGuard<'a, View>,
        wanted: Wanted,
    ) -> Result<MutexGuard<'a, View>, Error> {
        let mut arrived = None;
        let taken = ports.take_states(|message| {
            let state = arrived.insert(view.pool.copy(message));
            match wanted {
                Wanted::One if state.boot_id() == self.boot_id() => ControlFlow::Break(()),
                Wanted::One | Wanted::All => ControlFlow::Continue(()),
            }
        });
        taken.map_err(|error| Error::of_service(error, &self.instance))?;
        let Some(state) = arrived else {
            if self.last_state_ns.load(Ordering::Relaxed) == 0 {
                self.last_state_ns.store(clock::now_ns(), Ordering::Relaxed);
            }
            return Ok(view);
        };
        if state.boot_id() != self.boot_id() {
            drop(view);
            self.read_description()?;
            view = locked(&self.view);
        }
        // A state of a daemon that has ended meanwhile belongs to no known robot.
        if state.boot_id() == self.boot_id() && view.is_newer(&state) {
            self.cycle.store(state.cycle(), Ordering::Relaxed);
            view.put(state);
            self.last_state_ns.store(clock::now_ns(), Ordering::Relaxed);
        }
        Ok(view)
    }

    /// Returns the number of states so far, for [`sleep`](Self::sleep). Call it before checking for
    /// a state.
    pub(crate) fn published(&self) -> Option<u32> {
        self.ports.get().ok()?.published()
    }

    /// Sleeps until the daemon has published more than `seen` states, at most for `at_most`. May
    /// return early.
    pub(crate) fn sleep(&self, seen: Option<u32>, at_most: Duration) -> Result<(), Error> {
        self.ports.get()?.sleep(seen, at_most).map_err(|error| match error.obstacle {
            // The file was removed with its daemon.
            Obstacle::Version if self.is_dead() => self.silence_error(),
            _ => Error::of_service(error, &self.instance),
        })
    }

    /// Returns how long a caller that has waited for `waited` of `timeout` may continue. The first
    /// caller gets an error when the silence is too long; a caller that retries waits for its full
    /// time.
    pub(crate) fn remaining(
        &self,
        view: &mut View,
        waited: Duration,
        timeout: Duration,
    ) -> Result<Duration, Error> {
        let left = timeout.saturating_sub(waited);
        let until_silence = self.silence().saturating_sub(self.quiet());
        if until_silence.is_zero() && (left.is_zero() || !view.silence_reported) {
            view.silence_reported = true;
            return Err(self.silence_error());
        }
        if left.is_zero() {
            return Err(Error::Timeout { waited });
        }
        Ok(if view.silence_reported { left } else { left.min(until_silence) })
    }

    /// Returns the group of the newest state, taken or not, of a cycle after `since`. Returns
    /// `None` also while another thread holds the view.
    pub(crate) fn try_group(&self, index: usize, since: u64) -> Option<Group> {
        let view = self.try_view()?;
        view.newest.as_ref().filter(|state| state.cycle() > since)?.group(index)
    }

    /// Returns an IMU of the newest state, taken or not. Returns `None` also while another thread
    /// holds the view.
    pub(crate) fn try_imu(&self, index: usize) -> Option<Imu> {
        self.try_view()?.newest.as_ref()?.imu(index)
    }

    /// Returns the number of the newest published cycle; 0 before the first.
    pub(crate) fn newest_cycle(&self) -> Result<u64, Error> {
        drop(self.poll()?);
        Ok(self.cycle())
    }

    /// Sleeps until a state that arrives after the call contains the group in `phase` or past it.
    /// Calls `meanwhile` once a cycle, which must [process](Self::refresh) the states.
    pub(crate) fn wait_for(
        &self,
        index: usize,
        phase: Phase,
        timeout: Duration,
        mut meanwhile: impl FnMut() -> Result<(), Error>,
    ) -> Result<(), Error> {
        let (begun, since) = (Instant::now(), self.newest_cycle()?);
        let mut last = None;
        loop {
            meanwhile()?;
            if let Some(group) = self.try_group(index, since) {
                last = group.phase;
                if self.has_reached(index, &group, phase)? {
                    return Ok(());
                }
            }
            let left = timeout.saturating_sub(begun.elapsed());
            if left.is_zero() {
                let group = self.name_of(index);
                return Err(Error::NotReached { group, phase: last, expected: phase, waited: timeout });
            }
            std::thread::sleep(left.min(self.robot().period().max(ANSWER_POLL)));
        }
    }

    /// Returns `true` if `group` is in `phase` or past it. Fails for a stopped group, which does
    /// not start until a reset.
    fn has_reached(&self, index: usize, group: &Group, phase: Phase) -> Result<bool, Error> {
        use Phase::{Active, Damping, Disarmed, Starting};
        let (robot, name) = (self.robot(), self.name_of(index));
        if group.latched && matches!(phase, Starting | Active) {
            let joint = group.cause_joint.and_then(|joint| Some(robot.joints.get(joint)?.name.clone()));
            return Err(Error::Stopped { group: name, stop: Stop::of(group, joint) });
        }
        Ok(match phase {
            Active => group.phase == Some(Active),
            Starting => matches!(group.phase, Some(Starting | Active)),
            Damping => matches!(group.phase, Some(Damping | Disarmed)),
            Disarmed => group.phase == Some(Disarmed),
        })
    }

    fn name_of(&self, index: usize) -> String {
        self.robot().groups.get(index).map_or_else(String::new, |group| group.name.clone())
    }

    /// Returns the number of the newest state's cycle; 0 before the first.
    pub(crate) fn cycle(&self) -> u64 {
        self.cycle.load(Ordering::Relaxed)
    }

    /// Records that the caller has the state of `cycle`: its next setpoint answers this state.
    pub(crate) fn taken(&self, cycle: u64) {
        self.taken.store(cycle, Ordering::Relaxed);
    }

    /// Returns the number of the cycle whose state the caller has; 0 before the first.
    pub(crate) fn answered(&self) -> u64 {
        self.taken.load(Ordering::Relaxed)
    }

    /// Returns the robot of the daemon whose states arrive.
    pub(crate) fn robot(&self) -> Arc<RobotDescription> {
        Arc::clone(&locked(&self.robot))
    }

    /// Returns the boot id of the daemon whose states arrive.
    pub(crate) fn boot_id(&self) -> u64 {
        self.boot_id.load(Ordering::Acquire)
    }

    /// Fails with [`Error::NotRunning`] or [`Error::Silent`] when states do not arrive.
    pub(crate) fn check_alive(&self) -> Result<(), Error> {
        self.check_alive_at(clock::now_ns())
    }

    /// Works like [`check_alive`](Self::check_alive), with the current time from the caller.
    pub(crate) fn check_alive_at(&self, now_ns: u64) -> Result<(), Error> {
        if self.quiet_at(now_ns) >= self.silence() { Err(self.silence_error()) } else { Ok(()) }
    }

    pub(crate) fn set_silence(&self, silence: Duration) {
        self.silence_ns.store(nanos(silence).max(1), Ordering::Relaxed);
    }

    fn silence(&self) -> Duration {
        Duration::from_nanos(match self.silence_ns.load(Ordering::Relaxed) {
            0 => self.default_silence_ns.load(Ordering::Relaxed),
            set => set,
        })
    }

    fn quiet(&self) -> Duration {
        self.quiet_at(clock::now_ns())
    }

    fn quiet_at(&self, now_ns: u64) -> Duration {
        match self.last_state_ns.load(Ordering::Relaxed) {
            0 => Duration::ZERO,
            last_ns => Duration::from_nanos(now_ns.saturating_sub(last_ns)),
        }
    }

    fn silence_error(&self) -> Error {
        self.silence_error_after(self.quiet())
    }

    /// Returns the error for states that stopped `silent_for` ago: [`Error::Silent`] unless the
    /// daemon is dead.
    pub(crate) fn silence_error_after(&self, silent_for: Duration) -> Error {
        if self.is_dead() { Error::not_running(&self.instance) } else { Error::Silent { silent_for } }
    }

    /// Returns `true` if the daemon is known to be dead. Its process id proves nothing: daemon or
    /// client may be in a container.
    fn is_dead(&self) -> bool {
        liveness::is_dead(&self.instance)
    }

    /// Sends a request, and waits at most `timeout` for the answer.
    pub(crate) fn ask(
        &self,
        operation: Operation,
        subject: Subject,
        timeout: Duration,
    ) -> Result<(AdminReply, Vec<u8>), Error> {
        self.ask_while(operation, subject, timeout, || Ok(()))
    }

    /// Sends a request, and calls `meanwhile` repeatedly until the answer arrives.
    pub(crate) fn ask_while(
        &self,
        operation: Operation,
        subject: Subject,
        timeout: Duration,
        mut meanwhile: impl FnMut() -> Result<(), Error>,
    ) -> Result<(AdminReply, Vec<u8>), Error> {
        let ports = self.ports.get()?;
        let deadline = Instant::now() + timeout;
        let unanswered = || self.unanswered(operation, timeout);
        let _turn = self.turn(operation, deadline).ok_or_else(unanswered)?;
        let of_service = |error| Error::of_service(error, &self.instance);
        let question = ports.ask(subject.request(operation)).map_err(of_service)?;
        loop {
            meanwhile()?;
            match question.answer().map_err(of_service)? {
                Some((reply, text)) if reply.refusal == 0 => return Ok((reply, text)),
                Some((reply, _)) => {
                    return Err(self.refusal(operation, reply));
                }
                None if Instant::now() < deadline => std::thread::sleep(ANSWER_POLL),
                None => return Err(unanswered()),
            }
        }
    }

    /// Names the joint of a refusal, and its position if that is the reason.
    fn refusal(&self, operation: Operation, reply: AdminReply) -> Error {
        Error::refusal(operation, reply, &self.robot(), |joint| self.position_of(joint))
    }

    /// Returns the newest position of a joint, rad. Waits some cycles for the first state.
    fn position_of(&self, joint: usize) -> Option<f32> {
        for _ in 0..POSITION_TRIES {
            if let Some(state) = &self.poll().ok()?.newest {
                return state.joint(joint)?.position();
            }
            std::thread::sleep(self.robot().period().max(ANSWER_POLL));
        }
        None
    }

    /// Acquires the lock for a request: one ordinary request and one emergency stop may run at a
    /// time. `None` when the requests of other threads last until `deadline`.
    fn turn(&self, operation: Operation, deadline: Instant) -> Option<MutexGuard<'_, ()>> {
        let turns = if operation == Operation::EmergencyStop { &self.stop } else { &self.ordinary };
        loop {
            match turns.try_lock() {
                Ok(turn) => return Some(turn),
                Err(TryLockError::Poisoned(turn)) => return Some(turn.into_inner()),
                Err(TryLockError::WouldBlock) if Instant::now() < deadline => std::thread::sleep(ANSWER_POLL),
                Err(TryLockError::WouldBlock) => return None,
            }
        }
    }

    fn unanswered(&self, operation: Operation, waited: Duration) -> Error {
        if self.is_dead() {
            Error::not_running(&self.instance)
        } else {
            Error::NoAnswer { operation, waited }
        }
    }

    /// Sends a request that is answered with JSON.
    pub(crate) fn read<T: DeserializeOwned>(&self, operation: Operation, argument: f64) -> Result<T, Error> {
        let subject = Subject { argument, ..Subject::default() };
        let (_, text) = self.ask(operation, subject, ANSWER_TIMEOUT)?;
        serde_json::from_slice(&text).map_err(|_| Error::NotUnderstood { operation })
    }

    pub(crate) fn record_port(&self) -> Result<ForkGuard<RecordPort>, Error> {
        let ports = self.ports.get()?;
        ForkGuard::open(|| ports.record_port()).map_err(|error| match error.obstacle {
            // The daemon's version lacks this service.
            Obstacle::Missing if !self.is_dead() => Error::version(error.part, &self.instance),
            _ => Error::of_service(error, &self.instance),
        })
    }

    pub(crate) fn imu_sender(&self) -> Result<ForkGuard<ImuSender>, Error> {
        let ports = self.ports.get()?;
        ForkGuard::open(|| ports.imu_sender()).map_err(|error| Error::of_service(error, &self.instance))
    }

    pub(crate) fn setpoint_port(&self) -> Result<ForkGuard<SetpointPort>, Error> {
        let ports = self.ports.get()?;
        ForkGuard::open(|| ports.setpoint_port()).map_err(|error| Error::of_service(error, &self.instance))
    }

    /// Checks that the calling process opened this connection. Allocates nothing, and makes no
    /// system call.
    pub(crate) fn check_process(&self) -> Result<(), Error> {
        self.ports.get()?;
        Ok(())
    }

    /// Returns a file descriptor that becomes readable with each state.
    pub(crate) fn file_descriptor(&self) -> Result<BorrowedFd<'_>, Error> {
        let ports = self.ports.get()?;
        if let Some(events) = self.events.get() {
            return Ok(events.get()?.as_fd());
        }
        let events = ForkGuard::open(|| ports.state_events());
        let events = events.map_err(|error| Error::of_service(error, &self.instance))?;
        Ok(self.events.get_or_init(|| events).get()?.as_fd())
    }

    /// Makes the file descriptor unreadable until the next state, if the caller wanted one.
    pub(crate) fn clear_events(&self) -> Result<(), Error> {
        let Some(events) = self.events.get() else { return Ok(()) };
        events.get()?.clear().map_err(|error| Error::of_service(error, &self.instance))
    }

    /// Stops every motor through the socket alone. Async-signal-safe.
    pub(crate) fn stop_signal_safe(&self, timeout: Duration) -> Result<(), StopError> {
        self.stop_path.as_ref().map_err(|error| *error)?.stop(timeout)
    }

    /// Returns the instance, for errors of a port of this link.
    pub(crate) fn instance(&self) -> &Instance {
        &self.instance
    }

    fn read_description(&self) -> Result<(), Error> {
        let robot: RobotDescription = self.read(Operation::Describe, 0.0)?;
        let sound = |index: &usize| *index < robot.joints.len();
        if robot.joints.len() > JOINTS_MAX || !robot.groups.iter().flat_map(|group| &group.joints).all(sound)
        {
            return Err(Error::NotUnderstood { operation: Operation::Describe });
        }
        let cycles = Duration::try_from_secs_f64(SILENCE_CYCLES / robot.rate_hz).unwrap_or(SILENCE_MIN);
        self.default_silence_ns.store(nanos(cycles.max(SILENCE_MIN)), Ordering::Relaxed);
        let mut known = locked(&self.robot);
        self.boot_id.store(robot.boot_id, Ordering::Release);
        *known = Arc::new(robot);
        Ok(())
    }
}

/// Returns the value behind `mutex`. A thread that panicked while it held the lock left a valid
/// value: every write is one assignment.
pub(crate) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
