//! The client's side of the services.
//!
//! Threads may share the ports. Real-time threads must not use them: iceoryx2 may allocate,
//! and maps files when the daemon connects or disconnects.

use crate::descriptors;
use crate::futex::{Slept, Waiter};
use crate::iceoryx::{Lent, Payload, copied, descriptor_of, read};
use crate::imu::ImuSender;
use crate::instance::Attachment;
use crate::mutex::locked;
use crate::service::{self, Obstacle, Part, Service, ServiceError};
use crate::watcher::Watcher;
use iceoryx2::pending_response::PendingResponse;
use iceoryx2::port::client::Client;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::{Subscriber, SubscriberCreateError};
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::{event, publish_subscribe, request_response};
use motord_shared::limits::{ADMINS_MAX, RECORDERS_MAX, STOP_SLOTS};
use motord_shared::message::{
    AdminAnswer, AdminReply, AdminRequest, CycleRecord, SetpointMessage, StateMessage,
};
use nix::errno::Errno;
use std::ops::ControlFlow;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Longest sleep of a client. It bounds the effect of a process that requeues waiters to another
/// futex (`FUTEX_REQUEUE`). After a sleep of this length the client opens the file again: the next
/// daemon may use another one.
const SLEEP_MAX: Duration = Duration::from_millis(10);

/// The client's side of the services. The port of states takes its slot at its first use. A process
/// that only sends requests uses none, so an emergency stop finds a slot on a crowded robot.
///
/// Each port has a separate lock. It is held for microseconds, or for a millisecond when a daemon
/// connects or disconnects. A thread that sleeps until the next cycle holds none.
#[derive(Debug)]
pub struct ClientPorts {
    watcher: Mutex<Option<Watcher>>,
    /// `None` before the first sleep.
    waiter: Mutex<Option<Arc<Waiter>>>,
    admin: Client<Service, Payload<AdminRequest>, (), Payload<AdminAnswer>, ()>,
    admins: request_response::PortFactory<Service, Payload<AdminRequest>, (), Payload<AdminAnswer>, ()>,
    state: publish_subscribe::PortFactory<Service, Payload<StateMessage>, ()>,
    setpoint: publish_subscribe::PortFactory<Service, Payload<SetpointMessage>, ()>,
    node: Mutex<Node<Service>>,
    // Dropped last: a starting daemon may remove every file once no process is attached.
    attachment: Attachment,
}

impl ClientPorts {
    /// Opens the services of the instance of `attachment`.
    ///
    /// # Errors
    /// [`Obstacle::Missing`] without services; [`Obstacle::Full`] when only the slots for emergency
    /// stops are free; otherwise the service that failed and the reason.
    pub fn open(attachment: Attachment) -> Result<Self, ServiceError> {
        const MOST: usize = ADMINS_MAX - STOP_SLOTS;
        let ports = Self::open_to_stop(attachment)?;
        if ports.admins.dynamic_config().number_of_clients() > MOST {
            return Err(ServiceError { part: Part::Admin, obstacle: Obstacle::Full { most: MOST } });
        }
        Ok(ports)
    }

    /// Opens the services for an emergency stop, over slots that other clients cannot take.
    ///
    /// # Errors
    /// Those of [`open`](Self::open).
    pub fn open_to_stop(attachment: Attachment) -> Result<Self, ServiceError> {
        let directory = attachment.instance().root();
        Self::open_all(attachment).map_err(|error| error.explained(&directory))
    }

    fn open_all(attachment: Attachment) -> Result<Self, ServiceError> {
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

    /// Returns a copy of the newest state that was not taken yet.
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

    /// Passes the states that were not taken yet to `accept`, the newest last, until it breaks. The
    /// first call only takes the slot of a watcher. Never blocks.
    ///
    /// # Errors
    /// No free slot, or a damaged connection.
    pub fn take_states(
        &self,
        accept: impl FnMut(&StateMessage) -> ControlFlow<()>,
    ) -> Result<(), ServiceError> {
        let mut watcher = locked(&self.watcher);
        let port = match &mut *watcher {
            Some(watcher) => watcher,
            none => {
                check_descriptors(Part::State)?;
                none.insert(Watcher::new(&self.state).map_err(|error| self.explain(error))?)
            }
        };
        port.take(accept).map_err(|error| self.explain(error))?;
        if !port.is_deaf() {
            return Ok(());
        }
        // The next call connects again.
        *watcher = None;
        match self.explain(ServiceError { part: Part::State, obstacle: Obstacle::Damaged }) {
            // The daemon has ended meanwhile.
            ServiceError { obstacle: Obstacle::Damaged, .. } => Ok(()),
            error => Err(error),
        }
    }

    /// Returns the number of states so far, for [`sleep`](Self::sleep). Call it before checking for
    /// a state, so that [`sleep`](Self::sleep) misses none. `None` before the first sleep. Never
    /// blocks.
    #[must_use]
    pub fn published(&self) -> Option<u32> {
        locked(&self.waiter).as_ref().map(|waiter| waiter.count())
    }

    /// Sleeps until the daemon has published a state after `seen` was [read](Self::published), at
    /// most `timeout` or 10 ms. It may return early, and always does without `seen`. Any number of
    /// threads may sleep. Allocates only in the first call and after a restart of the daemon.
    ///
    /// # Errors
    /// [`Obstacle::Version`] when the daemon does not support this wake-up; a file that cannot be
    /// used.
    pub fn sleep(&self, seen: Option<u32>, timeout: Duration) -> Result<(), ServiceError> {
        let (Some(waiter), Some(seen)) = (locked(&self.waiter).clone(), seen) else {
            return self.open_waiter();
        };
        let slept = waiter.sleep(seen, timeout.min(SLEEP_MAX)).map_err(of_waiter)?;
        // A daemon that is late wakes it from the same file.
        if slept == Slept::TimedOut && !waiter.is_current() {
            // Without a file there is no daemon: the old file serves as well.
            let _none = self.open_waiter();
        }
        Ok(())
    }

    fn open_waiter(&self) -> Result<(), ServiceError> {
        let waiter = Waiter::open(self.attachment.instance()).map_err(of_waiter)?;
        *locked(&self.waiter) = Some(Arc::new(waiter));
        Ok(())
    }

    /// Returns a file descriptor that becomes readable with each state. It survives a restart of
    /// the daemon.
    ///
    /// # Errors
    /// No free slot, or no free file descriptor.
    pub fn state_events(&self) -> Result<StateEvents, ServiceError> {
        check_descriptors(Part::Cycle)?;
        let service = service::cycle(&locked(&self.node), self.attachment.instance()).open();
        let service = service.map_err(Part::Cycle.failed());
        service.and_then(|service| StateEvents::new(&service)).map_err(|error| self.explain(error))
    }

    /// Takes the slot of a recorder, which receives every cycle from now on.
    ///
    /// # Errors
    /// [`Obstacle::Missing`] when the daemon does not support recorders; no free slot.
    pub fn record_port(&self) -> Result<RecordPort, ServiceError> {
        check_descriptors(Part::Record)?;
        let node = locked(&self.node);
        let records = service::record(&node, self.attachment.instance()).open();
        let records = records.map_err(Part::Record.failed());
        let port = records.and_then(|records| records.subscriber_builder().create().map_err(of_recorders));
        Ok(RecordPort { port: port.map_err(|error| self.explain(error))? })
    }

    /// Returns a port for the setpoints of one group. A port holds one message: two groups need
    /// two.
    ///
    /// # Errors
    /// No free slot.
    pub fn setpoint_port(&self) -> Result<SetpointPort, ServiceError> {
        check_descriptors(Part::Setpoint)?;
        let builder = self.setpoint.publisher_builder().max_loaned_samples(1);
        let port = builder.backpressure_strategy(BackpressureStrategy::DiscardData).create();
        let port = port.map_err(|error| self.explain(Part::Setpoint.failed()(error)))?;
        Ok(SetpointPort { port })
    }

    /// Returns a port for the samples of external IMUs.
    ///
    /// # Errors
    /// [`Obstacle::Missing`] when the robot has no external IMU; no free slot;
    /// [`Obstacle::FullHere`].
    pub fn imu_sender(&self) -> Result<ImuSender, ServiceError> {
        check_descriptors(Part::Imu)?;
        let instance = self.attachment.instance();
        let service = service::imu(&locked(&self.node), instance).open().map_err(Part::Imu.failed());
        service.and_then(|service| ImuSender::new(&service, instance)).map_err(|error| self.explain(error))
    }

    /// Names used-up file descriptors, or a full file system, as the cause of an error.
    fn explain(&self, error: ServiceError) -> ServiceError {
        error.explained(&self.attachment.instance().root())
    }

    /// Sends an administrative request. At most
    /// [`REQUESTS_PER_CLIENT`](motord_shared::limits::REQUESTS_PER_CLIENT) may be open at a time.
    ///
    /// # Errors
    /// [`Obstacle::Missing`] when there is no daemon; otherwise a damaged connection.
    pub fn ask(&self, request: AdminRequest) -> Result<Question, ServiceError> {
        let pending = self.admin.send_copy(Payload(request));
        let pending = pending.map_err(|error| self.explain(Part::Admin.failed()(error)))?;
        if pending.number_of_server_connections() == 0 {
            return Err(self.explain(ServiceError { part: Part::Admin, obstacle: Obstacle::Missing }));
        }
        Ok(Question { pending })
    }
}

/// Receives every cycle. It buffers a quarter of a second at 1 kHz; gaps in
/// [`CycleRecord::sequence`] show lost records.
#[derive(Debug)]
pub struct RecordPort {
    port: Subscriber<Service, Payload<CycleRecord>, ()>,
}

impl RecordPort {
    /// Copies the oldest cycle that was not taken yet into `record`. Returns `false` without one.
    /// Never blocks.
    ///
    /// # Errors
    /// A damaged connection.
    pub fn take(&self, record: &mut CycleRecord) -> Result<bool, ServiceError> {
        let received = self.port.receive().map_err(|error| Part::Record.failed()(error).of_descriptors())?;
        Ok(received.map(|sample| *record = copied(sample.payload())).is_some())
    }
}

/// Checks that this process has the descriptors of a port: without them iceoryx2 creates a port
/// that never gets a connection.
fn check_descriptors(part: Part) -> Result<(), ServiceError> {
    match descriptors::are_fewer_than(descriptors::OF_PORT) {
        true => Err(ServiceError { part, obstacle: Obstacle::NoDescriptors }),
        false => Ok(()),
    }
}

fn of_waiter(errno: Errno) -> ServiceError {
    let obstacle = if errno == Errno::ENOENT { Obstacle::Version } else { errno.into() };
    ServiceError { part: Part::Cycle, obstacle }
}

/// The service has fewer slots for recorders than for watchers.
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
    port: Publisher<Service, Payload<SetpointMessage>, ()>,
}

impl SetpointPort {
    /// Sends `setpoint`, and replaces an older one that the daemon has not read. Never blocks. A
    /// missing receiver is no error: after the death of a daemon, no states arrive.
    ///
    /// # Errors
    /// A damaged connection.
    pub fn send(&self, setpoint: &SetpointMessage) -> Result<(), ServiceError> {
        let mut lent = self.port.loan_uninit().map(Lent::new).map_err(Part::Setpoint.failed())?;
        lent.write(setpoint);
        lent.sample().send().map_err(Part::Setpoint.failed())?;
        Ok(())
    }
}

/// An open request.
#[derive(Debug)]
pub struct Question {
    pending: PendingResponse<Service, Payload<AdminRequest>, (), Payload<AdminAnswer>, ()>,
}

impl Question {
    /// Returns the answer with its text, if it has arrived. Never blocks.
    ///
    /// # Errors
    /// [`Obstacle::Missing`] when the daemon dropped the request; otherwise a damaged connection.
    /// The death of the daemon is no error: the caller needs a time limit.
    pub fn answer(&self) -> Result<Option<(AdminReply, Vec<u8>)>, ServiceError> {
        let dropped = !self.pending.is_connected();
        let received = self.pending.receive();
        match received.map_err(|error| Part::Admin.failed()(error).of_descriptors())? {
            Some(response) => {
                let mut answer = Box::<AdminAnswer>::default();
                read(response.payload(), &mut answer);
                Ok(Some((answer.reply, answer.text().to_vec())))
            }
            None if dropped => {
                Err(ServiceError { part: Part::Admin, obstacle: Obstacle::Missing }.of_descriptors())
            }
            None => Ok(None),
        }
    }
}

/// Limit on the notifications that wait: the daemon sends one per state, and none while one is
/// unread.
const WAITING_MAX: usize = 4;

/// Becomes readable with each state. The daemon pays a system call for it in each cycle.
#[derive(Debug)]
pub struct StateEvents(Listener<Service>);

impl StateEvents {
    pub(crate) fn new(service: &event::PortFactory<Service>) -> Result<Self, ServiceError> {
        service.listener_builder().create().map(Self).map_err(Part::Cycle.failed())
    }

    /// Makes the descriptor unreadable until the next state. Call it before checking for a state.
    /// Makes a system call for each notification, and another one. Never blocks.
    ///
    /// # Errors
    /// A damaged connection.
    pub fn clear(&self) -> Result<(), ServiceError> {
        for _ in 0..WAITING_MAX {
            if self.0.try_wait(|_| ()).map_err(Part::Cycle.failed())? == 0 {
                break;
            }
        }
        Ok(())
    }
}

impl AsFd for StateEvents {
    fn as_fd(&self) -> BorrowedFd<'_> {
        descriptor_of(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::{ANSWERS, DaemonPorts};
    use crate::futex::Waker;
    use crate::instance::{Instance, InstanceLock};
    use motord_shared::limits::{JOINTS_MAX, REQUESTS_PER_CLIENT};
    use motord_shared::message::JointState;
    use std::sync::atomic::{AtomicU64, Ordering};

    /// Both sides, in a separate directory. The fields are dropped in this order.
    struct Ends {
        ports: DaemonPorts,
        client: ClientPorts,
        _lock: InstanceLock,
        _directory: tempfile::TempDir,
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
            let directory = tempfile::tempdir_in("/tmp").unwrap();
            let instance = Instance::below(directory.path(), "robot").unwrap();
            let lock = instance.lock().unwrap();
            let ports = DaemonPorts::open(&lock).unwrap();
            let client = ClientPorts::open(instance.attach().unwrap().unwrap()).unwrap();
            Self { ports, client, _lock: lock, _directory: directory }
        }
    }

    /// A controller whose daemon died sleeps for such a short time at the end of its time limit.
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

    /// The file changes when another user starts the daemon, or when a process removes it.
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

    /// Each message overwrites an earlier one.
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

    /// States arrive in every phase of the client's turn: while it computes, checks, goes to sleep
    /// and sleeps.
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

    /// A slow client gives up, and its answer arrives later.
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
                let _disconnected = request.reply(AdminReply::default(), b"");
            }
            let waits = client.ask(AdminRequest::default()).unwrap();
            ports.next_request().unwrap().unwrap().reply(AdminReply::default(), b"heard").unwrap();
            assert_eq!(waits.answer().unwrap().unwrap().1, b"heard", "{question}");
        }
    }

    #[test]
    fn damaged_files_of_client_block_no_start() {
        for kind in [".service", ".global_mgmt", ".details", "node_monitor_context"] {
            let directory = tempfile::tempdir_in("/tmp").unwrap();
            let instance = Instance::below(directory.path(), "robot").unwrap();
            let lock = instance.lock().unwrap();
            let ports = DaemonPorts::open(&lock).unwrap();
            let _client = ClientPorts::open(instance.attach().unwrap().unwrap()).unwrap();
            // As if the daemon was killed.
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

    /// Returns the files below `root` whose name has this end.
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
