//! The iceoryx2 services of an instance, with all their limits.
//!
//! | service | pattern | daemon | client |
//! |---|---|---|---|
//! | `motord/<instance>/state` | publish-subscribe | publishes each cycle | reads the newest |
//! | `motord/<instance>/record` | publish-subscribe | publishes each cycle while a recorder is connected | reads every one |
//! | `motord/<instance>/setpoint` | publish-subscribe | reads the newest of each owner | publishes |
//! | `motord/<instance>/imu` | publish-subscribe | reads every sample; only with an external IMU | publishes |
//! | `motord/<instance>/cycle` | event | notifies after each state | for the [file descriptor](crate::ClientPorts::state_events) of an event loop, and for other programs; a client that waits sleeps on a [number in a file](crate::ClientPorts::sleep) |
//! | `motord/<instance>/admin` | request-response | answers | requests |
//!
//! Everything is a file below the instance's directory, nothing is in `/dev/shm`. All users who may
//! enter the directory may connect; no others may.

use crate::descriptors;
use crate::iceoryx::{Payload, PortLock};
use crate::instance::Instance;
use crate::reserved_space;
use iceoryx2::node::NodeCreationFailure;
use iceoryx2::port::client::RequestSendError;
use iceoryx2::port::listener::ListenerCreateError;
use iceoryx2::port::notifier::{NotifierCreateError, NotifierNotifyError};
use iceoryx2::port::publisher::PublisherCreateError;
use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::port::update_connections::ConnectionFailure;
use iceoryx2::port::{LoanError, ReceiveError, SendError};
use iceoryx2::prelude::*;
use iceoryx2::service::Service as _;
use iceoryx2::service::builder::{event, publish_subscribe, request_response};
use iceoryx2::service::port_factory::client::ClientCreateError;
use iceoryx2::service::port_factory::server::ServerCreateError;
use iceoryx2::service::service_hash::ServiceHash;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_bb_lock_free::mpmc::counting_bit_set::RelocatableCountingBitSet;
use iceoryx2_cal::dynamic_storage::file::Storage;
use iceoryx2_cal::event::ListenerWaitError;
use iceoryx2_cal::event::trigger::State;
use iceoryx2_cal::event::trigger::unix_datagram_socket::GenericUnixDatagramSocketTrigger;
use iceoryx2_cal::shared_memory::file::Memory;
use iceoryx2_cal::shm_allocator::bump_allocator::BumpAllocator;
use iceoryx2_cal::shm_allocator::pool_allocator::PoolAllocator;
use motord_shared::limits::{
    ADMINS_MAX, CONTROLLERS_MAX, IMU_PUBLISHERS_MAX, IMU_SAMPLES_KEPT, RECORDERS_MAX, RECORDS_KEPT,
    REQUESTS_PER_CLIENT, WATCHERS_MAX,
};
use motord_shared::message::{
    AdminAnswer, AdminRequest, CycleRecord, ImuMessage, SetpointMessage, StateMessage,
};
use nix::errno::Errno;
use std::ffi::OsStr;
use std::fmt::Debug;
use std::os::unix::ffi::OsStrExt;
use std::path::PathBuf;

/// Limit on the processes of one instance: the daemon, and each client that may send requests. Dead
/// processes keep their slot until the next cleanup.
const NODES_MAX: usize = ADMINS_MAX + 8;

/// States buffered for a subscriber: a controller needs only the newest.
pub(crate) const STATE_BUFFER: usize = 2;

/// iceoryx2 with files instead of POSIX shared memory, which has no directory whose group could
/// restrict access. A lock around each port lets threads share a client. It is uncontended in the
/// daemon, where one thread uses every port.
#[derive(Debug, Clone)]
pub struct FileService {}

/// The service type of daemon and clients. Both must be built with the same one.
pub type Service = FileService;

impl iceoryx2::service::Service for FileService {
    type StaticStorage = iceoryx2_cal::static_storage::recommended::Ipc;
    type ConfigSerializer = iceoryx2_cal::serialize::recommended::Recommended;
    type PersistentDynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> = Storage<T>;
    type Bag = iceoryx2_cal::bag::recommended::Recommended;
    type DynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> = Storage<T>;
    type ServiceNameHasher = iceoryx2_cal::hash::recommended::Recommended;
    type SharedMemory = Memory<PoolAllocator>;
    type ResizableSharedMemory =
        iceoryx2_cal::resizable_shared_memory::dynamic::DynamicMemory<PoolAllocator, Memory<PoolAllocator>>;
    type Connection = iceoryx2_cal::zero_copy_connection::file::Connection;
    type Event = GenericUnixDatagramSocketTrigger<
        RelocatableCountingBitSet,
        Storage<State<RelocatableCountingBitSet, ()>>,
    >;
    type Monitoring = iceoryx2_cal::monitoring::recommended::Ipc;
    type Reactor = iceoryx2_cal::reactor::recommended::Ipc;
    type ArcThreadSafetyPolicy<T: Send + Debug + Abandonable> = PortLock<T>;
    type BlackboardMgmt<K: Send + Sync + Debug + ZeroCopySend + 'static> = Storage<K>;
    type BlackboardPayload = Memory<BumpAllocator>;
    type UniqueId = <ipc::Service as iceoryx2::service::Service>::UniqueId;
}

impl iceoryx2::service::internal::ServiceInternal<FileService> for FileService {}

/// One of the services, or their common part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// The registration of each process.
    Node,
    /// `motord/<instance>/state`.
    State,
    /// `motord/<instance>/record`.
    Record,
    /// `motord/<instance>/setpoint`.
    Setpoint,
    /// `motord/<instance>/imu`.
    Imu,
    /// `motord/<instance>/cycle`.
    Cycle,
    /// `motord/<instance>/admin`.
    Admin,
}

impl Part {
    /// Returns the last word of its service name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Node => "node",
            Self::State => "state",
            Self::Record => "record",
            Self::Setpoint => "setpoint",
            Self::Imu => "imu",
            Self::Cycle => "cycle",
            Self::Admin => "admin",
        }
    }
}

/// The reason why a process cannot use a service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Obstacle {
    /// The service does not exist.
    #[error("it does not exist: no daemon runs here")]
    Missing,
    /// The other side uses another layout or another version of iceoryx2.
    #[error(
        "daemon and client have different versions of it: install the same version of both, and restart both"
    )]
    Version,
    /// Its files may not be opened.
    #[error("no permission for its files: join the group that owns the runtime directory")]
    Permission,
    /// Every slot is in use.
    #[error("all {most} slots are in use: end a process that uses one")]
    Full {
        /// The number of slots.
        most: usize,
    },
    /// This process uses as many slots as one may have.
    #[error("this process uses {most} slots already: drop one of its publishers first")]
    FullHere {
        /// The limit.
        most: usize,
    },
    /// The disk of its files is full.
    #[error("no space for its files: free 32 MiB in the file system of the runtime directory")]
    NoSpace,
    /// This process, or the computer, has too few file descriptors left.
    #[error("too few file descriptors are left for its files: close some, or raise `ulimit -n`")]
    NoDescriptors,
    /// Its files cannot be used, or the memory ran out.
    #[error(
        "its files are damaged or memory ran out: stop every client and the daemon, then start the daemon"
    )]
    Damaged,
}

/// A service that cannot be used, and the reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("service {}: {obstacle}", part.name())]
pub struct ServiceError {
    /// The service.
    pub part: Part,
    /// The reason.
    pub obstacle: Obstacle,
}

impl ServiceError {
    /// Names the cause of damage that used-up file descriptors, or a full file system of
    /// `directory`, that of the services, explain: iceoryx2 reports all alike. Allocates.
    pub(crate) fn explained(self, directory: &std::path::Path) -> Self {
        match self.of_descriptors() {
            Self { part, obstacle: Obstacle::Damaged } if reserved_space::is_full(directory) => {
                Self { part, obstacle: Obstacle::NoSpace }
            }
            error => error,
        }
    }

    /// Names used-up file descriptors as the cause of damage, or of a missing daemon, that they
    /// explain: iceoryx2 skips a server whose files it cannot open. Allocates.
    pub(crate) fn of_descriptors(self) -> Self {
        match self.obstacle {
            Obstacle::Damaged | Obstacle::Missing
                if descriptors::are_fewer_than(descriptors::OF_CONNECTION) =>
            {
                Self { obstacle: Obstacle::NoDescriptors, ..self }
            }
            _ => self,
        }
    }
}

impl Part {
    /// Converts an error of iceoryx2 to one of this part.
    pub(crate) fn failed<E: Into<Obstacle>>(self) -> impl Fn(E) -> ServiceError {
        move |error| ServiceError { part: self, obstacle: error.into() }
    }
}

/// The obstacles for the errors of iceoryx2. Every error that is not listed means damage.
macro_rules! obstacles {
    ($($error:path { $($variant:ident $(($inner:ident))? => $obstacle:expr,)* })+) => {
        $(impl From<$error> for Obstacle {
            fn from(error: $error) -> Self {
                use $error as E;
                match error {
                    $(E::$variant $(($inner))? => $obstacle,)*
                    _ => Self::Damaged,
                }
            }
        })+
    };
}

obstacles! {
    NodeCreationFailure {
        InsufficientPermissions => Self::Permission,
    }
    publish_subscribe::PublishSubscribeOpenError {
        DoesNotExist => Self::Missing,
        IsMarkedForDestruction => Self::Missing,
        IncompatibleTypes => Self::Version,
        IncompatibleAttributes => Self::Version,
        IncompatibleOverflowBehavior => Self::Version,
        DoesNotSupportRequestedMinBufferSize => Self::Version,
        DoesNotSupportRequestedMinHistorySize => Self::Version,
        DoesNotSupportRequestedMinSubscriberBorrowedSamples => Self::Version,
        DoesNotSupportRequestedAmountOfPublishers => Self::Version,
        DoesNotSupportRequestedAmountOfSubscribers => Self::Version,
        DoesNotSupportRequestedAmountOfNodes => Self::Version,
        VersionMismatch => Self::Version,
        InsufficientPermissions => Self::Permission,
        ExceedsMaxNumberOfNodes => Self::Full { most: NODES_MAX },
    }
    publish_subscribe::PublishSubscribeCreateError {
        InsufficientPermissions => Self::Permission,
    }
    publish_subscribe::PublishSubscribeOpenOrCreateError {
        PublishSubscribeOpenError(error) => error.into(),
        PublishSubscribeCreateError(error) => error.into(),
    }
    event::EventOpenError {
        DoesNotExist => Self::Missing,
        IsMarkedForDestruction => Self::Missing,
        DoesNotSupportRequestedAmountOfNotifiers => Self::Version,
        DoesNotSupportRequestedAmountOfListeners => Self::Version,
        DoesNotSupportRequestedAmountOfNodes => Self::Version,
        VersionMismatch => Self::Version,
        InsufficientPermissions => Self::Permission,
        ExceedsMaxNumberOfNodes => Self::Full { most: NODES_MAX },
    }
    event::EventCreateError {
        InsufficientPermissions => Self::Permission,
    }
    event::EventOpenOrCreateError {
        EventOpenError(error) => error.into(),
        EventCreateError(error) => error.into(),
    }
    request_response::RequestResponseOpenError {
        DoesNotExist => Self::Missing,
        IsMarkedForDestruction => Self::Missing,
        IncompatibleRequestOrResponseType => Self::Version,
        IncompatibleAttributes => Self::Version,
        IncompatibleOverflowBehaviorForRequests => Self::Version,
        IncompatibleOverflowBehaviorForResponses => Self::Version,
        IncompatibleBehaviorForFireAndForgetRequests => Self::Version,
        DoesNotSupportRequestedAmountOfServers => Self::Version,
        DoesNotSupportRequestedAmountOfClients => Self::Version,
        DoesNotSupportRequestedAmountOfNodes => Self::Version,
        DoesNotSupportRequestedResponseBufferSize => Self::Version,
        DoesNotSupportRequestedAmountOfActiveRequestsPerClient => Self::Version,
        VersionMismatch => Self::Version,
        InsufficientPermissions => Self::Permission,
        ExceedsMaxNumberOfNodes => Self::Full { most: NODES_MAX },
    }
    request_response::RequestResponseCreateError {
        InsufficientPermissions => Self::Permission,
    }
    request_response::RequestResponseOpenOrCreateError {
        RequestResponseOpenError(error) => error.into(),
        RequestResponseCreateError(error) => error.into(),
    }
    PublisherCreateError {
        ExceedsMaxSupportedPublishers => Self::Full { most: CONTROLLERS_MAX },
    }
    SubscriberCreateError {
        ExceedsMaxSupportedSubscribers => Self::Full { most: WATCHERS_MAX },
    }
    ListenerCreateError {
        ExceedsMaxSupportedListeners => Self::Full { most: WATCHERS_MAX },
    }
    ClientCreateError {
        ExceedsMaxSupportedClients => Self::Full { most: ADMINS_MAX },
    }
}

impl Obstacle {
    /// Returns `true` when another attempt may succeed. A starting daemon removes damaged files, and a
    /// client may connect meanwhile.
    #[must_use]
    pub const fn is_transient(self) -> bool {
        matches!(self, Self::Full { .. } | Self::NoDescriptors | Self::Damaged)
    }
}

impl From<Errno> for Obstacle {
    fn from(errno: Errno) -> Self {
        match errno {
            Errno::ENOSPC | Errno::EDQUOT => Self::NoSpace,
            Errno::EACCES | Errno::EPERM => Self::Permission,
            errno if descriptors::is_lack(errno) => Self::NoDescriptors,
            _ => Self::Damaged,
        }
    }
}

/// Errors that always mean damage.
macro_rules! damages {
    ($($error:path,)+) => {
        $(impl From<$error> for Obstacle {
            fn from(_: $error) -> Self {
                Self::Damaged
            }
        })+
    };
}

damages! {
    NotifierCreateError,
    NotifierNotifyError,
    ListenerWaitError,
    ServerCreateError,
    LoanError,
    SendError,
    ReceiveError,
    ConnectionFailure,
    RequestSendError,
}

/// Registers this process without signal handlers. iceoryx2 logs nothing unless `IOX2_LOG_LEVEL` is
/// set, even in a program with another logger: errors are returned.
///
/// Only the daemon `cleans` up after dead processes: no process can clean up after one that is
/// killed during its cleanup.
pub(crate) fn node(instance: &Instance, cleans: bool) -> Result<Node<Service>, ServiceError> {
    set_log_level_from_env_or(LogLevel::Fatal);
    let mut config = config(instance);
    config.global.node.cleanup_dead_nodes_on_creation = cleans;
    config.global.node.cleanup_dead_nodes_on_destruction = cleans;
    config.global.service.cleanup_dead_nodes_on_open = cleans;
    NodeBuilder::new()
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .config(&config)
        .create::<Service>()
        .map_err(Part::Node.failed())
}

pub(crate) fn config(instance: &Instance) -> Config {
    let mut config = Config::default();
    let root = Path::new(instance.root().as_os_str().as_bytes());
    config.global.set_root_path(&root.expect("an instance's root is shorter than a path of iceoryx2"));
    config.global.prefix = FileName::new(b"m_").expect("this is a file name");
    // Places for senders that left unread messages. Each takes 3.6 KB of locked memory; the default
    // is 128.
    config.defaults.publish_subscribe.subscriber_expired_connection_buffer = CONTROLLERS_MAX;
    config
}

fn builder(
    node: &Node<Service>,
    instance: &Instance,
    part: Part,
) -> iceoryx2::service::builder::Builder<Service> {
    node.service_builder(&service_name(instance, part))
}

/// Returns the name in the table above; from the second round on with its number.
fn service_name(instance: &Instance, part: Part) -> ServiceName {
    let mut name = format!("motord/{}/{}", instance.name(), part.name());
    match instance.round() {
        0 => {}
        round => name.extend(["/", &round.to_string()]),
    }
    ServiceName::new(&name).expect("an instance name makes a short service name")
}

/// Returns the files by which clients find the services of `instance`, except the service for
/// recorders. They stay the same while a daemon or a client uses the services.
pub(crate) fn files(instance: &Instance) -> [PathBuf; 4] {
    let config = config(instance);
    let suffix = &config.global.service.static_config_storage_suffix;
    let directory = instance.root().join(OsStr::from_bytes(config.global.service.directory.as_bytes()));
    let patterns = [
        (Part::State, MessagingPattern::PublishSubscribe),
        (Part::Setpoint, MessagingPattern::PublishSubscribe),
        (Part::Cycle, MessagingPattern::Event),
        (Part::Admin, MessagingPattern::RequestResponse),
    ];
    patterns.map(|(part, pattern)| {
        let name = service_name(instance, part);
        let hash =
            ServiceHash::new::<<Service as iceoryx2::service::Service>::ServiceNameHasher>(&name, pattern);
        directory.join(format!("{}{}{suffix}", config.global.prefix, hash.as_str()))
    })
}

pub(crate) fn state(
    node: &Node<Service>,
    instance: &Instance,
) -> publish_subscribe::Builder<Payload<StateMessage>, (), Service> {
    builder(node, instance, Part::State)
        .publish_subscribe::<Payload<StateMessage>>()
        .enable_safe_overflow(true)
        .history_size(1)
        .subscriber_max_buffer_size(STATE_BUFFER)
        .subscriber_max_borrowed_samples(1)
        .max_publishers(1)
        .max_subscribers(WATCHERS_MAX)
        .max_nodes(NODES_MAX)
}

/// The service for recorders. Its few subscribers have buffers for a quarter of a second of cycles,
/// which the many watchers do not need.
pub(crate) fn record(
    node: &Node<Service>,
    instance: &Instance,
) -> publish_subscribe::Builder<Payload<CycleRecord>, (), Service> {
    builder(node, instance, Part::Record)
        .publish_subscribe::<Payload<CycleRecord>>()
        .enable_safe_overflow(true)
        .history_size(0)
        .subscriber_max_buffer_size(RECORDS_KEPT)
        .subscriber_max_borrowed_samples(1)
        .max_publishers(1)
        .max_subscribers(RECORDERS_MAX)
        .max_nodes(NODES_MAX)
}

pub(crate) fn setpoint(
    node: &Node<Service>,
    instance: &Instance,
) -> publish_subscribe::Builder<Payload<SetpointMessage>, (), Service> {
    builder(node, instance, Part::Setpoint)
        .publish_subscribe::<Payload<SetpointMessage>>()
        .enable_safe_overflow(true)
        .history_size(0)
        .subscriber_max_buffer_size(1)
        .subscriber_max_borrowed_samples(1)
        .max_publishers(CONTROLLERS_MAX)
        .max_subscribers(1)
        .max_nodes(NODES_MAX)
}

/// The service for the samples of external IMUs.
pub(crate) fn imu(
    node: &Node<Service>,
    instance: &Instance,
) -> publish_subscribe::Builder<Payload<ImuMessage>, (), Service> {
    builder(node, instance, Part::Imu)
        .publish_subscribe::<Payload<ImuMessage>>()
        .enable_safe_overflow(true)
        .history_size(0)
        .subscriber_max_buffer_size(IMU_SAMPLES_KEPT)
        .subscriber_max_borrowed_samples(1)
        .max_publishers(IMU_PUBLISHERS_MAX)
        .max_subscribers(1)
        .max_nodes(NODES_MAX)
}

pub(crate) fn cycle(node: &Node<Service>, instance: &Instance) -> event::Builder<Service> {
    builder(node, instance, Part::Cycle)
        .event()
        .event_id_max_value(0)
        .disable_deadline()
        .disable_notifier_created_event()
        .disable_notifier_dropped_event()
        .disable_notifier_dead_event()
        .max_notifiers(1)
        .max_listeners(WATCHERS_MAX)
        .max_nodes(NODES_MAX)
}

pub(crate) fn admin(
    node: &Node<Service>,
    instance: &Instance,
) -> request_response::Builder<Payload<AdminRequest>, (), Payload<AdminAnswer>, (), Service> {
    builder(node, instance, Part::Admin)
        .request_response::<Payload<AdminRequest>, Payload<AdminAnswer>>()
        .enable_safe_overflow_for_requests(false)
        // An unread answer to an earlier request must not block the next answer.
        .enable_safe_overflow_for_responses(true)
        .enable_fire_and_forget_requests(false)
        .max_active_requests_per_client(REQUESTS_PER_CLIENT)
        .max_loaned_requests(1)
        .max_response_buffer_size(1)
        .max_borrowed_responses_per_pending_response(1)
        .max_servers(1)
        .max_clients(ADMINS_MAX)
        .max_nodes(NODES_MAX)
}

/// Returns the layout on the other side of `part`, for the report of a mismatch. `None` when
/// unknown.
#[must_use]
pub fn layout(instance: &Instance, part: Part) -> Option<String> {
    let pattern = match part {
        Part::State | Part::Record | Part::Setpoint | Part::Imu => MessagingPattern::PublishSubscribe,
        Part::Admin => MessagingPattern::RequestResponse,
        Part::Node | Part::Cycle => return None,
    };
    let details =
        Service::details(&service_name(instance, part), &config(instance), pattern).ok()??.static_details;
    Some(match part {
        Part::Admin => {
            let service = details.request_response();
            let request = service.request_message_type_details().payload.type_name();
            format!("{request} and {}", service.response_message_type_details().payload.type_name())
        }
        _ => details.publish_subscribe().message_type_details().payload.type_name().to_string(),
    })
}
