//! The cycle and the simulated motors of a configuration on virtual time.
//!
//! [`Twin`] runs the cycle of the daemon: its decisions, limits, drives and frames. Its buses have
//! simulated motors, and [`Mechanics`] of the caller move their joints, such as a physics engine.
//! The same calls with the same seed give the same run.
//!
//! [`physics`] and [`simulate`] make the simulated motors of a configuration, here and in the
//! daemon.

mod coupled;
mod error;
mod imus;
mod joints;
mod physics;
mod twin;

pub use coupled::{coupled, simulate_all};
pub use error::{NUMBER_MAX, TwinError};
pub use imus::{Body, sample};
pub use joints::{JointPhysics, Mechanics};
pub use physics::{armature, physics, simulate};
pub use twin::{Options, Twin, TwinClock};

pub use motord_simulator::{FaultVerb, ImuValues, InjectError, VerbError};
