//! The daemon's side of the services.
//!
//! Threads may share the ports. Real-time threads must not use them: iceoryx2 may allocate,
//! and maps files when a client connects or disconnects.

use crate::futex::Waker;
use crate::iceoryx::{Lent, Payload, answered, copied, read};
use crate::imu::ImuReceiver;
use crate::instance::{Instance, InstanceLock};
use crate::instance_error::InstanceError;
use crate::mutex::locked;
use crate::reserved_space;
use crate::service::{self, Obstacle, Part, STATE_BUFFER, Service, ServiceError};
use iceoryx2::active_request::ActiveRequest;
use iceoryx2::port::ReceiveError;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::server::Server;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{BackpressureStrategy, *};
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use motord_shared::CycleRecord;
use motord_shared::limits::{
    ADMINS_MAX, CONTROLLERS_MAX, RECORDERS_MAX, RECORDS_KEPT, REQUESTS_PER_CLIENT, WATCHERS_MAX,
};
use motord_shared::message::{AdminAnswer, AdminReply, AdminRequest, SetpointMessage, StateMessage};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Longest time that a starting daemon waits while other processes remove its dead predecessor.
const CLEANING_TIMEOUT: Duration = Duration::from_secs(1);

/// Answers in memory: one for each open request, and one that is being written.
pub(crate) const ANSWERS: usize = REQUESTS_PER_CLIENT * ADMINS_MAX + 1;

/// States in memory. All watchers share the newest states; each watcher may read an older one, and
/// one is written.
const STATES: usize = STATE_BUFFER + WATCHERS_MAX + 2;

/// The daemon's side of the services.
#[derive(Debug)]
pub struct DaemonPorts {
    /// The message of the next state.
    next: Mutex<Option<Lent<Service, StateMessage>>>,
    state: Publisher<Service, Payload<StateMessage>, ()>,
    recorders: Recorders,
    setpoint: Subscriber<Service, Payload<SetpointMessage>, ()>,
    waker: Arc<Waker>,
    cycle: Notifier<Service>,
    admin: Server<Service, Payload<AdminRequest>, (), Payload<AdminAnswer>, ()>,
    damage: Option<ServiceError>,
    node: Node<Service>,
}

impl DaemonPorts {
    /// Opens the services of the instance of `lock`, or creates them. The clients of a dead
    /// predecessor stay attached to this daemon. If their shared files are damaged, this removes
    /// the files, and the clients must reconnect. Keep the lock for the lifetime of the ports. May
    /// take some seconds.
    ///
    /// # Errors
    /// The service that could not be opened, and the reason.
    pub fn open(lock: &InstanceLock) -> Result<Self, ServiceError> {
        let instance = lock.instance();
        reserved_space::check(&instance.root(), reserved_space::DAEMON_BYTES).map_err(Part::Node.failed())?;
        let waker = Arc::new(Waker::open(lock).map_err(of_futex)?);
        let _opening = lock.opening();
        let opened = Self::open_services(instance, &waker).map_err(ServiceError::of_descriptors);
        let ports = match opened {
            // Processes with damaged files occupy slots that no process can free.
            Err(damage) if matches!(damage.obstacle, Obstacle::Damaged | Obstacle::Full { .. }) => {
                lock.clear();
                Self { damage: Some(damage), ..Self::open_services(instance, &waker)? }
            }
            opened => opened?,
        };
        reserved_space::occupy(&instance.root()).map_err(Part::Node.failed())?;
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
                .override_sample_preallocation(|_| STATES)
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
                .map_err(Part::State.failed())?,
            recorders: Recorders::new(records, instance.root()),
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
            node,
        })
    }

    /// Returns the obstacle for which the files of a predecessor were removed: its clients must
    /// reconnect. `None` without damage.
    #[must_use]
    pub fn damage(&self) -> Option<ServiceError> {
        self.damage
    }

    /// Opens the service for the samples of external IMUs of the instance of `lock`. Opening takes
    /// milliseconds.
    ///
    /// # Errors
    /// The reason why it could not be opened.
    pub fn open_imus(&self, lock: &InstanceLock) -> Result<ImuReceiver, ServiceError> {
        let service = service::imu(&self.node, lock.instance()).open_or_create();
        ImuReceiver::new(&service.map_err(Part::Imu.failed())?)
    }

    /// Sends `state` to every watcher, and replaces an older one that it has not read. Never
    /// blocks.
    ///
    /// # Errors
    /// A damaged connection; the other watchers have received the state.
    pub fn publish(&self, state: &StateMessage) -> Result<(), ServiceError> {
        let ready = locked(&self.next).take();
        let mut lent = ready.map_or_else(|| self.lend_state(), Ok)?;
        // Most of a message is unused. Writing that part would waste time.
        lent.write(state);
        lent.sample().send().map_err(Part::State.failed())?;
        Ok(())
    }

    /// Prepares the message of the next state. The caches of this processor hold it then.
    /// [`publish`](Self::publish) does not wait for the cache of the client that read it last.
    /// Publishing works without this call, but takes longer. Never blocks.
    pub fn prepare(&self) {
        // `publish` tries again and returns the error.
        if let Ok(mut lent) = self.lend_state() {
            lent.fetch();
            *locked(&self.next) = Some(lent);
        }
    }

    fn lend_state(&self) -> Result<Lent<Service, StateMessage>, ServiceError> {
        self.state.loan_uninit().map(Lent::new).map_err(Part::State.failed())
    }

    /// Returns the recorders, for any thread.
    #[must_use]
    pub const fn recorders(&self) -> &Recorders {
        &self.recorders
    }

    /// Wakes every client that sleeps until the next cycle: one system call for all of them, and
    /// one for each listener of the event `cycle` of iceoryx2. Never blocks.
    ///
    /// # Errors
    /// A damaged connection of a listener; all other clients are awake.
    pub fn notify(&self) -> Result<(), ServiceError> {
        self.waker.wake();
        self.cycle.notify().map_err(Part::Cycle.failed())?;
        Ok(())
    }

    /// Passes the newest setpoints of each controller to `accept`. They are copies: the sender may
    /// still write to the original. Takes at most sixteen times as many messages as there may be
    /// controllers. Therefore constant senders cannot block the owner's message. Never blocks.
    ///
    /// # Errors
    /// A damaged connection; earlier setpoints were passed on.
    pub fn take_setpoint(&self, mut accept: impl FnMut(&SetpointMessage)) -> Result<(), ServiceError> {
        for _ in 0..16 * CONTROLLERS_MAX {
            let Some(sample) = self.setpoint.receive().map_err(Part::Setpoint.failed())? else { break };
            let mut setpoint = SetpointMessage::default();
            read(sample.payload(), &mut setpoint);
            accept(&setpoint);
        }
        Ok(())
    }

    /// Returns the next administrative request, if any. A client with too many open requests must
    /// wait for an answer or drop one. Never blocks.
    ///
    /// # Errors
    /// A damaged connection.
    pub fn next_request(&self) -> Result<Option<Request>, ServiceError> {
        let request = match self.admin.receive() {
            Err(ReceiveError::ExceedsMaxBorrows) => None,
            received => received.map_err(Part::Admin.failed())?,
        };
        Ok(request.map(|active| Request { payload: copied(active.payload()), active }))
    }
}

fn of_futex(error: InstanceError) -> ServiceError {
    let obstacle = match error {
        InstanceError::System { errno, .. } => errno.into(),
        _ => Obstacle::Permission,
    };
    ServiceError { part: Part::Cycle, obstacle }
}

/// A request without an answer yet. When it is dropped, the requester receives an error.
#[derive(Debug)]
pub struct Request {
    payload: AdminRequest,
    active: ActiveRequest<Service, Payload<AdminRequest>, (), Payload<AdminAnswer>, ()>,
}

impl Request {
    /// Returns the request, as a copy that its sender cannot change.
    #[must_use]
    pub fn payload(&self) -> &AdminRequest {
        &self.payload
    }

    /// Returns `true` while the requester waits for the answer.
    #[must_use]
    pub fn is_awaited(&self) -> bool {
        self.active.is_connected()
    }

    /// Answers with `reply` and `text`, truncated to
    /// [`ANSWER_BYTES_MAX`](motord_shared::limits::ANSWER_BYTES_MAX) bytes. Never blocks.
    ///
    /// # Errors
    /// The requester has disconnected, or holds too many answers.
    pub fn reply(self, reply: AdminReply, text: &[u8]) -> Result<(), ServiceError> {
        let answer = self.active.loan_uninit().map_err(Part::Admin.failed())?;
        answered(answer, reply, text).send().map_err(Part::Admin.failed())
    }
}

/// Records in memory. All recorders share the newest records; each recorder may read an older one,
/// and one is written.
const RECORDS: usize = RECORDS_KEPT + RECORDERS_MAX + 2;
/// The file of the records, and the connections of the recorders.
const BYTES: usize = RECORDS * size_of::<CycleRecord>() + (1 << 20);

/// The recorders that are connected.
#[derive(Debug, Clone)]
pub struct Recorders {
    service: Arc<PortFactory<Service, Payload<CycleRecord>, ()>>,
    directory: PathBuf,
}

/// Sends records to every recorder.
#[derive(Debug)]
pub struct RecordSender(Publisher<Service, Payload<CycleRecord>, ()>);

impl Recorders {
    pub(crate) fn new(service: PortFactory<Service, Payload<CycleRecord>, ()>, directory: PathBuf) -> Self {
        Self { service: Arc::new(service), directory }
    }

    /// Returns `true` while a recorder is connected.
    #[must_use]
    pub fn are_connected(&self) -> bool {
        self.service.dynamic_config().number_of_subscribers() > 0
    }

    /// Opens the port, with memory for a quarter of a second of a 1 kHz cycle. Takes milliseconds:
    /// use it on a thread without deadlines.
    ///
    /// # Errors
    /// The reason why it could not be opened.
    pub fn open(&self) -> Result<RecordSender, ServiceError> {
        reserved_space::check(&self.directory, BYTES as i64).map_err(Part::Record.failed())?;
        let publisher = self
            .service
            .publisher_builder()
            .max_loaned_samples(1)
            .override_sample_preallocation(|_| RECORDS)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(Part::Record.failed())?;
        reserved_space::occupy(&self.directory).map_err(Part::Record.failed())?;
        Ok(RecordSender(publisher))
    }
}

impl RecordSender {
    /// Sends `record` to every recorder. A recorder whose buffer is full loses its oldest record.
    /// Never blocks.
    ///
    /// # Errors
    /// A damaged connection; the other recorders have received the record.
    pub fn send(&self, record: &CycleRecord) -> Result<(), ServiceError> {
        let sample = self.0.loan_uninit().map_err(Part::Record.failed())?;
        sample.write_payload(Payload(*record)).send().map_err(Part::Record.failed())?;
        Ok(())
    }
}
