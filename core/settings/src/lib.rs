//! The settings of `motord-core`, and the two sides of its joints.
//!
//! - [`settings`]: the checked configuration.
//! - [`plan`]: the part of each cycle that the buses need.
//! - [`imu`]: IMUs, and their mounts on the body.
//! - [`imu_load`]: the load of IMUs on CAN buses.
//! - [`joint`]: the two sides of a joint, and the one transmission between them.
//! - [`feedback`]: the codes of velocity and torque, whose rounding errors are carried.
//!
//! Values only: no socket, no thread, no file and no clock.

#![forbid(unsafe_code)]

pub mod feedback;
pub mod imu;
pub mod imu_load;
pub mod joint;
pub mod plan;
pub mod settings;
