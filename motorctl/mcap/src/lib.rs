//! Recordings of cycles: every state, setpoint, applied command and event, as MCAP files.
//!
//! - [`Writer`] writes a file, [`Reader`] reads it.
//! - [`Events`] detects changes from cycle to cycle, [`Stops`] the safe stops.
//! - [`Memory`] keeps the last seconds.
//! - [`Topic`] encodes the messages of a state, for programs that send them elsewhere.
//! - [`Clock`] detects that the computer's clock was set.
//!
//! The feature `files`, on by default, is for files. Without it there are events, and the messages
//! of a state.
//!
//! The format is [MCAP](https://mcap.dev) with Protobuf messages, compressed by zstd. Each file
//! carries the schemas, `proto/motord.proto`, and the description of the robot.
//!
//! | topic | message | how often |
//! |---|---|---|
//! | `/robot` | the description of the robot, JSON | once, first |
//! | `/joints/NAME` | `motord.Joint` | every cycle |
//! | `/groups/NAME` | `motord.Group` | every cycle |
//! | `/buses/NAME` | `motord.Bus` | every cycle |
//! | `/indicators/NAME` | `motord.Indicators`, of the joint `NAME` | when one has changed |
//! | `/imus/NAME` | `motord.Imu` | when a sample was received, or something else has changed |
//! | `/cycle` | `motord.Cycle` | every cycle, the last of its messages |
//! | `/events` | `foxglove.Log` | when something has changed |

#![forbid(unsafe_code)]

mod clock;
#[cfg(feature = "files")]
mod decode;
mod encode;
mod events;
#[cfg(feature = "files")]
mod memory;
#[cfg(feature = "files")]
mod messages;
#[cfg(feature = "files")]
mod reader;
mod topic;
#[cfg(feature = "files")]
mod writer;

pub use clock::{Clock, ClockStep, Origin, Reading};
pub use events::{Event, Events, Level, Stops};
#[cfg(feature = "files")]
pub use memory::{Memory, Remembered};
#[cfg(feature = "files")]
pub use messages::ReadError;
#[cfg(feature = "files")]
pub use reader::Reader;
pub use topic::Topic;
#[cfg(feature = "files")]
pub use writer::{Counts, Writer};

/// The messages, made from `proto/`: `verify/house/src/generated.rs`.
#[allow(unreachable_pub, reason = "prost makes it")]
mod motord {
    include!("../generated/motord.rs");
}

/// Foxglove's messages, generated in the same way.
#[allow(unreachable_pub, reason = "prost makes it")]
mod foxglove {
    include!("../generated/foxglove.rs");
}

/// The schemas, as a `google.protobuf.FileDescriptorSet`.
pub const SCHEMA: &[u8] = include_bytes!("../generated/schema.bin");
