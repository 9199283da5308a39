//! Recordings of cycles: every state, setpoint, applied command and event, as MCAP files.
//!
//! - [`Writer`] writes a file, [`Reader`] reads it.
//! - [`Events`] detects changes from cycle to cycle, [`Stops`] the safe stops.
//! - [`Memory`] keeps the last seconds.
//! - [`Clock`] detects that the computer's clock was set.
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
mod decode;
mod encode;
mod events;
mod memory;
mod messages;
mod reader;
mod writer;

pub use clock::{Clock, ClockStep, Origin, Reading};
pub use events::{Event, Events, Level, Stops};
pub use memory::{Memory, Remembered};
pub use messages::ReadError;
pub use reader::Reader;
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
const SCHEMA: &[u8] = include_bytes!("../generated/schema.bin");
