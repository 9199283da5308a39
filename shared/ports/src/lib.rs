//! Paths to motord: shared-memory ports, the runtime directory, and the sockets beside them.
//!
//! - [`instance`]: the runtime directory of an instance, and the permission to use it.
//! - [`service`]: the iceoryx2 services, with their limits.
//! - [`DaemonPorts`] and [`ClientPorts`]: the two ends of the services.
//! - [`RoleLock`]: at most one dead man's switch per instance.
//! - [`Housekeeper`]: removes the files of dead processes.
//! - [`liveness`]: detects that a daemon is dead.
//! - [`Presence`]: detects that the files of a daemon were removed.
//! - [`stop_socket`]: the socket for emergency stops. [`running`]: all of them.
//! - [`peer`]: users whose processes may answer on these sockets, and hold the locks.
//! - [`injection`]: faults for simulated buses.
//! - [`permission`]: advice for a user without permission.
//! - [`ForkGuard`]: a value that a forked process neither uses nor drops.
//! - [`clock`]: the clock of every time stamp.

mod client;
pub mod clock;
mod daemon;
mod descriptors;
mod directory;
mod fork;
#[allow(unsafe_code, reason = "no safe crate registers a handler of forks")]
mod fork_gate;
mod futex;
#[allow(unsafe_code, reason = "iceoryx2 has no other way")]
mod iceoryx;
mod imu;
pub mod injection;
pub mod instance;
mod instance_error;
mod leftovers;
pub mod liveness;
mod lock_file;
#[allow(
    unsafe_code,
    reason = "no safe crate maps a number that other processes write, or that a fork clears"
)]
mod mapping;
mod mutex;
pub mod peer;
pub mod permission;
mod presence;
mod reserved_space;
mod role;
pub mod running;
pub mod service;
pub mod stop_socket;
pub mod stop_source;
mod watcher;

pub use client::{ClientPorts, Question, RecordPort, SetpointPort, StateEvents};
pub use daemon::{DaemonPorts, RecordSender, Recorders, Request};
pub use fork::{Creator, ForkGuard, Forked};
pub use iceoryx::Payload;
pub use imu::{ImuReceiver, ImuSender};
pub use instance::{Attachment, Instance, InstanceError, InstanceLock};
pub use leftovers::Housekeeper;
pub use peer::{Impostor, TrustedUsers};
pub use presence::Presence;
pub use role::RoleLock;
pub use service::ServiceError;
