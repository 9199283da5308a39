//! The two ends of the services: what the daemon holds, and what a client holds.
//!
//! Threads may share every end. None of the methods belongs into a real-time thread: iceoryx2 allocates with every message,
//! and maps files when the other side comes or goes.

use crate::futex::{Slept, Waiter, Waker};
use crate::iceoryx::Lent;
use crate::instance::{Attachment, Instance, InstanceLock};
use crate::instance_error::InstanceError;
use crate::leftovers;
use crate::limits::{
    ADMINS_MAX, ANSWER_BYTES_MAX, CONTROLLERS_MAX, RECORDERS_MAX, REQUESTS_PER_CLIENT, STOP_PLACES,
};
use crate::message::{AdminAnswer, AdminReply, AdminRequest, CycleRecord, SetpointMessage, StateMessage};
use crate::reserved_space;
use crate::service::{self, Obstacle, Part, Service, ServiceError};
use iceoryx2::active_request::ActiveRequest;
use iceoryx2::pending_response::PendingResponse;
use iceoryx2::port::ReceiveError;
use iceoryx2::port::client::Client;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::server::Server;
use iceoryx2::port::subscriber::{Subscriber, SubscriberCreateError};
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::{publish_subscribe, request_response};
use nix::errno::Errno;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How long a starting daemon waits for others that are removing its dead predecessor.
const CLEANING_TIMEOUT: Duration = Duration::from_secs(1);

/// Longest sleep of a client: it bounds what a member can do who moves sleepers to a number of his own (`FUTEX_REQUEUE`). The next daemon may
/// have another file: whoever slept for so long opens it again.
const SLEEP_MAX: Duration = Duration::from_millis(10);

/// Answers in memory: each client may have one to each of its requests waiting and one being read, and one is being written.
const ANSWERS: usize = (REQUESTS_PER_CLIENT + 1) * ADMINS_MAX + 1;

/// The daemon's ends of the services.
#[derive(Debug)]
pub struct DaemonPorts {
    /// The message of the next state.
    next: Mutex<Option<Lent<Service, StateMessage>>>,
    state: Publisher<Service, StateMessage, ()>,
    record: Publisher<Service, CycleRecord, ()>,
    records: publish_subscribe::PortFactory<Service, CycleRecord, ()>,
    setpoint: Subscriber<Service, SetpointMessage, ()>,
    waker: Arc<Waker>,
    cycle: Notifier<Service>,
    admin: Server<Service, AdminRequest, (), AdminAnswer, ()>,
    damage: Option<ServiceError>,
    _node: Node<Service>,
}

impl DaemonPorts {
    /// Opens the services of the instance that is held by `lock`, or creates them. Clients that were attached to a dead
    /// predecessor are attached to this daemon from now on; where what they keep alive is damaged, it is removed, and they must
    /// connect again. Keep the lock for as long as the ports. May take some seconds.
    ///
    /// # Errors
    /// Which service could not be opened, and why.
    pub fn open(lock: &InstanceLock) -> Result<Self, ServiceError> {
        let instance = lock.instance();
        reserved_space::check(&instance.root()).map_err(no_space)?;
        let waker = Arc::new(Waker::open(lock).map_err(of_futex)?);
        let _opening = lock.opening();
        let ports = match Self::open_services(instance, &waker) {
            // Places that nobody can free are taken by processes whose files are damaged.
            Err(damage) if matches!(damage.obstacle, Obstacle::Damaged | Obstacle::Full { .. }) => {
                lock.clear();
                Self { damage: Some(damage), ..Self::open_services(instance, &waker)? }
            }
            opened => opened?,
        };
        reserved_space::occupy(&instance.root()).map_err(no_space)?;
        Ok(ports)
    }

    fn open_services(instance: &Instance, waker: &Arc<Waker>) -> Result<Self, ServiceError> {
        let node = service::node(instance, true)?;
        node.blocking_cleanup_dead_nodes(CLEANING_TIMEOUT);
        let state = service::state(&node, instance).open_or_create().map_err(Part::State.failed())?;
        let records = service::record(&node, instance).open_or_create().map_err(Part::Record.failed())?;
        let setpoint =
            service::setpoint(&node, instance).open_or_create().map_err(Part::Setpoint.failed())?;
        let cycle = service::cycle(&node, instance).open_or_create().map_err(Part::Cycle.failed())?;
        let admin = service::admin(&node, instance).open_or_create().map_err(Part::Admin.failed())?;
        Ok(Self {
            next: Mutex::default(),
            state: state
                .publisher_builder()
                .max_loaned_samples(1)
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
                .map_err(Part::State.failed())?,
            record: records
                .publisher_builder()
                .max_loaned_samples(1)
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
                .map_err(Part::Record.failed())?,
            records,
            setpoint: setpoint.subscriber_builder().create().map_err(Part::Setpoint.failed())?,
            waker: Arc::clone(waker),
            cycle: cycle.notifier_builder().create().map_err(Part::Cycle.failed())?,
            admin: admin
                .server_builder()
                .max_loaned_responses_per_request(1)
                .override_response_preallocation(|_| ANSWERS)
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
                .map_err(Part::Admin.failed())?,
            damage: None,
            _node: node,
        })
    }

    /// The obstacle for which the files of a predecessor were removed: its clients must connect again. `None` when there was none.
    #[must_use]
    pub fn damage(&self) -> Option<ServiceError> {
        self.damage
    }

    /// Gives `state` to every watcher, in place of an older one that it has not read. Never blocks.
    ///
    /// # Errors
    /// When a connection is damaged; the other watchers have it.
    pub fn publish(&self, state: &StateMessage) -> Result<(), ServiceError> {
        let ready = locked(&self.next).take();
        let mut lent = ready.map_or_else(|| self.lend_state(), Ok)?;
        // Most of a message is not in use. To write that, too, would take longer for nothing.
        lent.message().copy_from(state);
        lent.sample().send().map_err(Part::State.failed())?;
        Ok(())
    }

    /// Makes the message of the next state ready: the caches of this processor hold it then, and [`publish`](Self::publish) does not wait
    /// for that of the client who read it last. Publishing works without it, and takes longer. Never blocks.
    pub fn prepare(&self) {
        // `publish` tries again, and tells why not.
        if let Ok(mut lent) = self.lend_state() {
            lent.message().fetch();
            *locked(&self.next) = Some(lent);
        }
    }

    fn lend_state(&self) -> Result<Lent<Service, StateMessage>, ServiceError> {
        self.state.loan_uninit().map(Lent::new).map_err(Part::State.failed())
    }

    /// Somebody records.
    #[must_use]
    pub fn is_recorded(&self) -> bool {
        self.records.dynamic_config().number_of_subscribers() > 0
    }

    /// Gives `record` to every recorder, in place of the oldest that it has not read where it is too slow. Wakes nobody. Never
    /// blocks.
    ///
    /// # Errors
    /// When a connection is damaged; the other recorders have it.
    pub fn record(&self, record: &CycleRecord) -> Result<(), ServiceError> {
        let sample = self.record.loan_uninit().map_err(Part::Record.failed())?;
        sample.write_payload(*record).send().map_err(Part::Record.failed())?;
        Ok(())
    }

    /// Wakes every client that sleeps until the next cycle: one system call for all of them, and one for each listener of the event `cycle`
    /// of iceoryx2. Never blocks.
    ///
    /// # Errors
    /// When a connection of a listener is damaged; all others are awake.
    pub fn notify(&self) -> Result<(), ServiceError> {
        self.waker.wake();
        self.cycle.notify().map_err(Part::Cycle.failed())?;
        Ok(())
    }

    /// Shows `accept` the newest setpoints of each controller, as copies of what is in use: their sender may still write to the
    /// original. Takes at most sixteen times as many messages as there may be controllers: others that send without pause cannot keep
    /// the owner's from being reached. Never blocks.
    ///
    /// # Errors
    /// When a connection is damaged; what came before it was shown.
    pub fn take_setpoint(&self, mut accept: impl FnMut(&SetpointMessage)) -> Result<(), ServiceError> {
        for _ in 0..16 * CONTROLLERS_MAX {
            let Some(sample) = self.setpoint.receive().map_err(Part::Setpoint.failed())? else { break };
            let mut setpoint = SetpointMessage::default();
            setpoint.copy_from(sample.payload());
            accept(&setpoint);
        }
        Ok(())
    }

    /// The next administrative request, if one waits. That of a client which has as many under way as it may waits until one of them is
    /// answered or dropped. Never blocks.
    ///
    /// # Errors
    /// When a connection is damaged.
    pub fn next_request(&self) -> Result<Option<Request>, ServiceError> {
        let request = match self.admin.receive() {
            Err(ReceiveError::ExceedsMaxBorrows) => None,
            received => received.map_err(Part::Admin.failed())?,
        };
        Ok(request.map(|active| Request { payload: *active.payload(), active }))
    }
}

fn no_space(errno: Errno) -> ServiceError {
    ServiceError { part: Part::Node, obstacle: obstacle(errno) }
}

fn of_futex(error: InstanceError) -> ServiceError {
    let obstacle = match error {
        InstanceError::System { errno, .. } => obstacle(errno),
        _ => Obstacle::Permission,
    };
    ServiceError { part: Part::Cycle, obstacle }
}

const fn obstacle(errno: Errno) -> Obstacle {
    match errno {
        Errno::ENOSPC | Errno::EDQUOT => Obstacle::NoSpace,
        Errno::EACCES | Errno::EPERM => Obstacle::Permission,
        _ => Obstacle::Damaged,
    }
}

/// A request that waits for its answer. When it is dropped, the asker learns that no answer will come.
#[derive(Debug)]
pub struct Request {
    payload: AdminRequest,
    active: ActiveRequest<Service, AdminRequest, (), AdminAnswer, ()>,
}

impl Request {
    /// The request itself, as a copy that its sender cannot write to.
    #[must_use]
    pub fn payload(&self) -> &AdminRequest {
        &self.payload
    }

    /// Whether its asker still waits for the answer.
    #[must_use]
    pub fn is_awaited(&self) -> bool {
        self.active.is_connected()
    }

    /// Answers with `reply` and `text`, which may have [`ANSWER_BYTES_MAX`] bytes; the rest is cut off. Never blocks.
    ///
    /// # Errors
    /// When the asker is gone, or holds too many answers.
    pub fn reply(self, reply: AdminReply, text: &[u8]) -> Result<(), ServiceError> {
        let mut response = self.active.loan().map_err(Part::Admin.failed())?;
        let length = text.len().min(ANSWER_BYTES_MAX);
        let answer = response.payload_mut();
        answer.reply = reply;
        answer.length = length as u32;
        answer.text[..length].copy_from_slice(&text[..length]);
        response.send().map_err(Part::Admin.failed())
    }
}

/// Removes what dead processes left behind, so that their places become free. It opens files: use it about once per
/// second, on a thread where that does no harm.
#[derive(Debug)]
pub struct Housekeeper {
    node: Node<Service>,
    instance: Instance,
}

impl Housekeeper {
    /// A housekeeper of the instance that is held by `lock`.
    ///
    /// # Errors
    /// When this process cannot register itself.
    pub fn open(lock: &InstanceLock) -> Result<Self, ServiceError> {
        let instance = lock.instance().clone();
        Ok(Self { node: service::node(&instance, true)?, instance })
    }

    /// Cleans. Returns the number of dead processes that were removed. Files of processes that died while they registered stay
    /// for 10 s; files that cannot be removed stay until the next start.
    #[must_use]
    pub fn clean(&self) -> u64 {
        let removed = self.node.try_cleanup_dead_nodes().cleanups;
        let _refused = leftovers::remove(&self.instance);
        removed
    }
}

/// A client's ends of the services. The port of states takes its place when it is first used: a process that only sends requests
/// takes none, so that an emergency stop finds a place on a crowded robot.
///
/// Each port has a lock of its own, which is held for microseconds; only a daemon that comes or goes makes it a millisecond.
/// A thread that sleeps until the next cycle holds none.
#[derive(Debug)]
pub struct ClientPorts {
    watcher: Mutex<Option<Subscriber<Service, StateMessage, ()>>>,
    /// `None` before the first sleep.
    waiter: Mutex<Option<Arc<Waiter>>>,
    admin: Client<Service, AdminRequest, (), AdminAnswer, ()>,
    admins: request_response::PortFactory<Service, AdminRequest, (), AdminAnswer, ()>,
    state: publish_subscribe::PortFactory<Service, StateMessage, ()>,
    setpoint: publish_subscribe::PortFactory<Service, SetpointMessage, ()>,
    node: Mutex<Node<Service>>,
    // The last to go: a daemon that starts may wipe every file once nobody is attached.
    attachment: Attachment,
}

impl ClientPorts {
    /// Opens the services of the instance that `attachment` belongs to.
    ///
    /// # Errors
    /// [`Obstacle::Missing`] when there are none; [`Obstacle::Full`] when only the places for emergency stops are left;
    /// else which could not be opened, and why.
    pub fn open(attachment: Attachment) -> Result<Self, ServiceError> {
        const MOST: usize = ADMINS_MAX - STOP_PLACES;
        let ports = Self::open_to_stop(attachment)?;
        if ports.admins.dynamic_config().number_of_clients() > MOST {
            return Err(ServiceError { part: Part::Admin, obstacle: Obstacle::Full { most: MOST } });
        }
        Ok(ports)
    }

    /// Opens the services for an emergency stop: some places are kept for it, however many others are connected.
    ///
    /// # Errors
    /// Those of [`open`](Self::open).
    pub fn open_to_stop(attachment: Attachment) -> Result<Self, ServiceError> {
        let instance = attachment.instance();
        let node = service::node(instance, false)?;
        let state = service::state(&node, instance).open().map_err(Part::State.failed())?;
        let setpoint = service::setpoint(&node, instance).open().map_err(Part::Setpoint.failed())?;
        let admins = service::admin(&node, instance).open().map_err(Part::Admin.failed())?;
        let admin = admins
            .client_builder()
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(Part::Admin.failed())?;
        Ok(Self {
            watcher: Mutex::default(),
            waiter: Mutex::default(),
            admin,
            admins,
            state,
            setpoint,
            node: Mutex::new(node),
            attachment,
        })
    }

    /// The newest state that was not taken yet, as a copy.
    ///
    /// # Errors
    /// Those of [`take_states`](Self::take_states).
    pub fn newest_state(&self) -> Result<Option<StateMessage>, ServiceError> {
        let mut newest = None;
        self.take_states(|state| {
            newest = Some(*state);
            ControlFlow::Continue(())
        })?;
        Ok(newest)
    }

    /// Shows `accept` the states that were not taken yet, the newest last, until it says that it has enough. The first call only takes
    /// the place of a watcher. Never blocks.
    ///
    /// # Errors
    /// When there is no place, or the connection is damaged.
    pub fn take_states(
        &self,
        mut accept: impl FnMut(&StateMessage) -> ControlFlow<()>,
    ) -> Result<(), ServiceError> {
        let mut watcher = locked(&self.watcher);
        let watcher = match &mut *watcher {
            Some(watcher) => watcher,
            none => {
                let builder = self.state.subscriber_builder().buffer_size(1);
                none.insert(builder.create().map_err(Part::State.failed())?)
            }
        };
        // One state of a dead daemon may come before those of its successor.
        for _ in 0..3 {
            let Some(sample) = watcher.receive().map_err(Part::State.failed())? else { break };
            if accept(sample.payload()).is_break() {
                break;
            }
        }
        Ok(())
    }

    /// The number of states so far, for [`sleep`](Self::sleep). Ask for it before you look for a state: no state comes unnoticed between
    /// the two. `None` before the first sleep. Never blocks.
    #[must_use]
    pub fn published(&self) -> Option<u32> {
        locked(&self.waiter).as_ref().map(|waiter| waiter.count())
    }

    /// Sleeps until the daemon has published a state after `seen` was [asked for](Self::published), at most `timeout` or 10 ms. It
    /// may return early without reason, and without `seen` it does. Any number of threads may sleep.
    ///
    /// # Errors
    /// [`Obstacle::Version`] when the daemon is too old to wake clients like this; when its file cannot be used.
    pub fn sleep(&self, seen: Option<u32>, timeout: Duration) -> Result<(), ServiceError> {
        let (Some(waiter), Some(seen)) = (locked(&self.waiter).clone(), seen) else {
            return self.open_waiter();
        };
        let slept = waiter.sleep(seen, timeout.min(SLEEP_MAX)).map_err(of_waiter)?;
        if slept == Slept::TimedOut {
            // Without a file there is no daemon, and the old one is as good.
            let _none = self.open_waiter();
        }
        Ok(())
    }

    fn open_waiter(&self) -> Result<(), ServiceError> {
        let waiter = Waiter::open(self.attachment.instance()).map_err(of_waiter)?;
        *locked(&self.waiter) = Some(Arc::new(waiter));
        Ok(())
    }

    /// Takes the place of a recorder: it gets every cycle from now on.
    ///
    /// # Errors
    /// [`Obstacle::Missing`] when the daemon is older than recorders; when there is no place.
    pub fn record_port(&self) -> Result<RecordPort, ServiceError> {
        let node = locked(&self.node);
        let records = service::record(&node, self.attachment.instance()).open();
        let port = records.map_err(Part::Record.failed())?.subscriber_builder().create();
        Ok(RecordPort { port: port.map_err(of_recorders)? })
    }

    /// A port for the setpoints of one group. A port holds one message: two groups need two.
    ///
    /// # Errors
    /// When there is no place.
    pub fn setpoint_port(&self) -> Result<SetpointPort, ServiceError> {
        let builder = self.setpoint.publisher_builder().max_loaned_samples(1);
        let port = builder.backpressure_strategy(BackpressureStrategy::DiscardData).create();
        Ok(SetpointPort { port: port.map_err(Part::Setpoint.failed())? })
    }

    /// Sends an administrative request. At most [`REQUESTS_PER_CLIENT`] may be under way at a time.
    ///
    /// # Errors
    /// [`Obstacle::Missing`] when there is no daemon; else that the connection is damaged.
    pub fn ask(&self, request: AdminRequest) -> Result<Question, ServiceError> {
        let pending = self.admin.send_copy(request).map_err(Part::Admin.failed())?;
        if pending.number_of_server_connections() == 0 {
            return Err(ServiceError { part: Part::Admin, obstacle: Obstacle::Missing });
        }
        Ok(Question { pending })
    }
}

/// The value behind `mutex`. A thread that panicked while it held the lock left a valid value: every write is one
/// assignment.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Receives every cycle. It keeps those of half a second at 1 kHz; what it loses shows in [`CycleRecord::sequence`].
#[derive(Debug)]
pub struct RecordPort {
    port: Subscriber<Service, CycleRecord, ()>,
}

impl RecordPort {
    /// Copies the oldest cycle that was not taken yet into `record`. Returns whether there was one. Never blocks.
    ///
    /// # Errors
    /// When the connection is damaged.
    pub fn take(&self, record: &mut CycleRecord) -> Result<bool, ServiceError> {
        let received = self.port.receive().map_err(Part::Record.failed())?;
        Ok(received.map(|sample| *record = *sample.payload()).is_some())
    }
}

fn of_waiter(errno: Errno) -> ServiceError {
    let obstacle = if errno == Errno::ENOENT { Obstacle::Version } else { obstacle(errno) };
    ServiceError { part: Part::Cycle, obstacle }
}

/// There are fewer places for recorders than for watchers.
fn of_recorders(error: SubscriberCreateError) -> ServiceError {
    match error {
        SubscriberCreateError::ExceedsMaxSupportedSubscribers => {
            ServiceError { part: Part::Record, obstacle: Obstacle::Full { most: RECORDERS_MAX } }
        }
        error => Part::Record.failed()(error),
    }
}

/// Sends setpoints.
#[derive(Debug)]
pub struct SetpointPort {
    port: Publisher<Service, SetpointMessage, ()>,
}

impl SetpointPort {
    /// Sends `setpoint`, in place of an older one that the daemon has not read. Never blocks. That nobody listens is no
    /// error: a dead daemon shows by the states that stop.
    ///
    /// # Errors
    /// When the connection is damaged.
    pub fn send(&self, setpoint: &SetpointMessage) -> Result<(), ServiceError> {
        let mut lent = self.port.loan_uninit().map(Lent::new).map_err(Part::Setpoint.failed())?;
        lent.message().copy_from(setpoint);
        lent.sample().send().map_err(Part::Setpoint.failed())?;
        Ok(())
    }
}

/// A request under way.
#[derive(Debug)]
pub struct Question {
    pending: PendingResponse<Service, AdminRequest, (), AdminAnswer, ()>,
}

impl Question {
    /// The answer with its text, if it has come. Never blocks.
    ///
    /// # Errors
    /// [`Obstacle::Missing`] when the daemon dropped the request; else that the connection is damaged. That a daemon
    /// died is no error: whoever waits needs a time limit.
    pub fn answer(&self) -> Result<Option<(AdminReply, Vec<u8>)>, ServiceError> {
        let dropped = !self.pending.is_connected();
        match self.pending.receive().map_err(Part::Admin.failed())? {
            Some(response) => Ok(Some((response.payload().reply, response.payload().text().to_vec()))),
            None if dropped => Err(ServiceError { part: Part::Admin, obstacle: Obstacle::Missing }),
            None => Ok(None),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::JOINTS_MAX;
    use crate::message::JointState;
    use std::sync::atomic::{AtomicU64, Ordering};

    /// Both ends, in a directory of their own. The fields are dropped in this order.
    struct Ends {
        ports: DaemonPorts,
        client: ClientPorts,
        _lock: InstanceLock,
        _place: tempfile::TempDir,
    }

    /// Longer than any stall.
    const LONG: Duration = Duration::from_secs(60);

    impl ClientPorts {
        fn waiter(&self) -> Arc<Waiter> {
            self.sleep(None, Duration::ZERO).unwrap();
            locked(&self.waiter).clone().unwrap()
        }
    }

    impl Ends {
        fn open() -> Self {
            let place = tempfile::tempdir_in("/tmp").unwrap();
            let instance = Instance::below(place.path(), "robot").unwrap();
            let lock = instance.lock().unwrap();
            let ports = DaemonPorts::open(&lock).unwrap();
            let client = ClientPorts::open(instance.attach().unwrap().unwrap()).unwrap();
            Self { ports, client, _lock: lock, _place: place }
        }
    }

    /// A controller waits so shortly at the end of its patience, whose daemon has died.
    #[test]
    fn a_sleep_of_less_than_a_microsecond_ends() {
        let Ends { client, .. } = &Ends::open();
        client.sleep(None, Duration::ZERO).unwrap();
        for timeout in [Duration::ZERO, Duration::from_nanos(999)] {
            client.sleep(client.published(), timeout).unwrap();
            client.sleep(client.published(), timeout).unwrap();
        }
    }

    #[test]
    fn newer_state_prevents_sleep_and_older_never_wakes() {
        let Ends { ports, client, .. } = &Ends::open();
        assert_eq!(client.newest_state().unwrap(), None);
        let waiter = client.waiter();
        for cycle in 1..=3_u32 {
            let seen = waiter.count();
            assert_eq!(seen, cycle - 1, "states so far");
            ports.publish(&StateMessage { cycle: cycle.into(), ..StateMessage::default() }).unwrap();
            ports.notify().unwrap();
            assert_eq!(waiter.sleep(seen, LONG), Ok(Slept::Woken));
            assert_eq!(client.newest_state().unwrap().map(|state| state.cycle), Some(cycle.into()));
            assert_eq!(waiter.sleep(waiter.count(), Duration::from_millis(1)), Ok(Slept::TimedOut));
        }
    }

    /// Its file is another one when another user starts it, or when somebody removed the file.
    #[test]
    fn client_with_other_file_wakes_after_one_sleep() {
        let ends = Ends::open();
        ends.client.sleep(None, Duration::ZERO).unwrap();
        std::fs::remove_file(ends._lock.instance().futex_path()).unwrap();
        ends.client.sleep(ends.client.published(), Duration::ZERO).unwrap();
        let waker = Waker::open(&ends._lock).unwrap();
        ends.client.sleep(ends.client.published(), Duration::from_millis(1)).unwrap();
        let seen = ends.client.published();
        waker.wake();
        assert_ne!(ends.client.published(), seen);
    }

    /// Each message is written over an earlier one.
    #[test]
    fn a_state_has_nothing_of_those_before_it() {
        let ends = Ends::open();
        let Ends { ports, client, .. } = &ends;
        assert_eq!(client.newest_state().unwrap(), None);
        for count in [JOINTS_MAX, 12, 0, 1, JOINTS_MAX, 0, 0, 3, 2] {
            let mut state = StateMessage { joint_count: count as u32, ..StateMessage::default() };
            state.joints[..count].fill(JointState { missed: 7, ..JointState::default() });
            ports.publish(&state).unwrap();
            assert!(client.newest_state().unwrap() == Some(state), "{count}");
            for _ in 0..count % 3 {
                ports.prepare();
            }
        }
    }

    /// The states come at any moment of the client's turn: while it computes, looks, goes to sleep and sleeps.
    #[test]
    fn no_state_is_slept_through() {
        const STATES: u64 = 20_000;
        let Ends { ports, client, .. } = &Ends::open();
        assert_eq!(client.newest_state().unwrap(), None);
        let (waiter, taken) = (client.waiter(), AtomicU64::new(0));
        std::thread::scope(|threads| {
            threads.spawn(|| {
                for cycle in 1..=STATES {
                    while taken.load(Ordering::Acquire) < cycle - 1 {
                        std::thread::yield_now();
                    }
                    (0..cycle % 1000).for_each(|_| std::hint::spin_loop());
                    ports.publish(&StateMessage { cycle, ..StateMessage::default() }).unwrap();
                    ports.notify().unwrap();
                }
            });
            for cycle in 1..=STATES {
                loop {
                    let seen = waiter.count();
                    if client.newest_state().unwrap().is_some_and(|state| state.cycle == cycle) {
                        break;
                    }
                    assert_eq!(waiter.sleep(seen, LONG), Ok(Slept::Woken), "state {cycle}");
                }
                taken.store(cycle, Ordering::Release);
            }
        });
    }

    /// A client whose process is slow gives up, and its answer comes all the same.
    #[test]
    fn dropped_questions_leave_room_for_others() {
        let ends = Ends::open();
        let Ends { ports, client, .. } = &ends;
        for question in 0..2 * ANSWERS {
            let dropped_before = client.ask(AdminRequest::default()).unwrap();
            drop(dropped_before);
            assert!(ports.next_request().unwrap().is_none(), "{question}");
            let dropped_after = client.ask(AdminRequest::default()).unwrap();
            let request = ports.next_request().unwrap().unwrap();
            if question % 2 == 0 {
                request.reply(AdminReply::default(), b"").unwrap();
                drop(dropped_after);
            } else {
                drop(dropped_after);
                let _gone = request.reply(AdminReply::default(), b"");
            }
            let waits = client.ask(AdminRequest::default()).unwrap();
            ports.next_request().unwrap().unwrap().reply(AdminReply::default(), b"heard").unwrap();
            assert_eq!(waits.answer().unwrap().unwrap().1, b"heard", "{question}");
        }
    }

    #[test]
    fn damaged_files_of_client_block_no_start() {
        for kind in [".service", ".global_mgmt", ".details", "node_monitor_context"] {
            let place = tempfile::tempdir_in("/tmp").unwrap();
            let instance = Instance::below(place.path(), "robot").unwrap();
            let lock = instance.lock().unwrap();
            let ports = DaemonPorts::open(&lock).unwrap();
            let _client = ClientPorts::open(instance.attach().unwrap().unwrap()).unwrap();
            // A daemon that was killed.
            std::mem::forget(ports);
            drop(lock);
            let damaged = files_of(&instance.root(), kind);
            assert!(!damaged.is_empty(), "{kind}");
            for path in damaged {
                std::fs::write(path, "").unwrap();
            }
            let lock = instance.lock().unwrap();
            let _ports = DaemonPorts::open(&lock).unwrap_or_else(|error| panic!("{kind}: {error}"));
            assert!(ClientPorts::open(instance.attach().unwrap().unwrap()).is_ok(), "{kind}");
        }
    }

    /// Those below `root` whose name ends so.
    fn files_of(root: &std::path::Path, end: &str) -> Vec<std::path::PathBuf> {
        let mut found = Vec::new();
        for entry in std::fs::read_dir(root).unwrap().map(Result::unwrap) {
            match entry.file_type().unwrap().is_dir() {
                true => found.extend(files_of(&entry.path(), end)),
                false if entry.file_name().to_string_lossy().ends_with(end) => found.push(entry.path()),
                false => {}
            }
        }
        found
    }

    #[test]
    fn client_exceeding_requests_damages_nothing() {
        let ends = Ends::open();
        let Ends { ports, client, .. } = &ends;
        let mut kept = Vec::new();
        for _ in 0..REQUESTS_PER_CLIENT {
            let dropped = client.ask(AdminRequest::default()).unwrap();
            kept.extend(ports.next_request().unwrap());
            drop(dropped);
        }
        let waits = client.ask(AdminRequest::default()).unwrap();
        assert!(ports.next_request().unwrap().is_none());
        kept.clear();
        ports.next_request().unwrap().unwrap().reply(AdminReply::default(), b"heard").unwrap();
        assert_eq!(waits.answer().unwrap().unwrap().1, b"heard");
    }
}
