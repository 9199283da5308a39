//! The data exchanged between motord and its clients. No I/O, no clock, no iceoryx2.
//!
//! - [`message`]: the shared-memory layouts. They contain integers and floats only: another process
//!   may write any bytes, and a `bool` or an `enum` with such bytes would be undefined behaviour.
//! - [`JointState`]: the state of a joint, from the table [`joint_state!`], with a [`Field`] for
//!   each row.
//! - [`BusState`]: the state of a bus, from the table [`bus_counters!`].
//! - [`codes`]: the meaning of the integers. A number becomes a code by `TryFrom`, and every code
//!   has a name and a sentence.
//! - [`packed`]: messages as bytes for a network.
//! - [`Lease`]: the right to command a group.
//! - [`description`]: names and limits of the joints, and telemetry, as text.
//! - [`limits`]: all limits, as constants.
//!
//! Units are SI and joint side: rad, rad/s, N·m, N·m/rad, N·m·s/rad; temperatures in °C; times in
//! nanoseconds of `CLOCK_MONOTONIC`.

mod bus;
pub mod codes;
pub mod description;
mod field;
mod imu;
mod joint;
mod lease;
pub mod limits;
pub mod message;
pub mod packed;
pub mod plain;

pub use codes::{
    BusCondition, Cause, Fault, ImuContradiction, Indicator, Limit, MotorMode, Operation, Phase, Refusal,
    Rejection, SetpointMode,
};
pub use field::{Field, Kind};
pub use imu::ImuState;
pub use lease::Lease;
pub use limits::DEFAULT_INSTANCE;
pub use message::{
    AdminAnswer, AdminReply, AdminRequest, Applied, BusState, CycleRecord, GroupState, JointIndicators,
    JointSetpoint, JointState, SetpointMessage, StateMessage,
};
