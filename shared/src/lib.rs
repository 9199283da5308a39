//! Everything that crosses the process boundary between motord and its clients, and nothing else.
//!
//! - [`message`]: the shared-memory layouts. Integers and floats only: another process may write any bytes there, so a
//!   `bool` or an `enum` in them would be undefined behaviour waiting for a bad client.
//! - [`codes`]: the meaning of the integers. A number becomes a code by `TryFrom`, and every code has a name and a sentence.
//! - [`Lease`]: the right to command a group.
//! - [`description`]: names and limits of the joints, and what the tool asks for, as text.
//! - [`limits`]: every bound, by name.
//! - [`instance`]: where daemon and clients meet, and who may.
//! - [`permission`]: how somebody who may not use a directory gets the right to.
//! - [`injection`]: faults for simulated buses.
//! - [`service`]: the iceoryx2 services, with every limit of theirs.
//! - [`ports`]: the two ends of the services.
//! - [`stop_socket`]: the way for emergency stops that needs no file.
//! - [`clock`]: the clock of every time stamp.
//!
//! Without the feature `ports` there are only messages, codes, limits and descriptions: no file, no clock, no iceoryx2.
//!
//! Units are SI and joint side: rad, rad/s, N·m, N·m/rad, N·m·s/rad; temperatures in °C; times in nanoseconds of
//! `CLOCK_MONOTONIC`.

#[cfg(feature = "ports")]
pub mod clock;
pub mod codes;
pub mod description;
#[cfg(feature = "ports")]
mod directory;
#[allow(unsafe_code, reason = "no safe crate maps a number that other processes write")]
#[cfg(feature = "ports")]
mod futex;
#[allow(unsafe_code, reason = "iceoryx2 has no other way")]
#[cfg(feature = "ports")]
mod iceoryx;
#[cfg(feature = "ports")]
pub mod injection;
#[cfg(feature = "ports")]
pub mod instance;
#[cfg(feature = "ports")]
mod instance_error;
mod lease;
#[cfg(feature = "ports")]
mod leftovers;
pub mod limits;
pub mod message;
#[cfg(feature = "ports")]
pub mod permission;
#[cfg(feature = "ports")]
pub mod ports;
#[cfg(feature = "ports")]
mod presence;
#[cfg(feature = "ports")]
mod reserved_space;
#[cfg(feature = "ports")]
pub mod service;
#[cfg(feature = "ports")]
pub mod stop_socket;

pub use codes::{
    BusCondition, Cause, Fault, Indicator, Limit, MotorMode, Operation, Phase, Refusal, Rejection,
    SetpointMode,
};
#[cfg(feature = "ports")]
pub use instance::{Instance, InstanceError, InstanceLock};
pub use lease::Lease;
pub use limits::DEFAULT_INSTANCE;
pub use message::{
    AdminAnswer, AdminReply, AdminRequest, Applied, BusState, CycleRecord, GroupState, JointIndicators,
    JointSetpoint, JointState, SetpointMessage, StateMessage,
};
#[cfg(feature = "ports")]
pub use ports::{ClientPorts, DaemonPorts, Housekeeper, RecordPort, Request};
#[cfg(feature = "ports")]
pub use presence::Presence;
#[cfg(feature = "ports")]
pub use service::ServiceError;
