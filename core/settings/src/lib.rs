//! The settings of `motord-core`.
//!
//! - [`settings`]: the checked configuration.
//! - [`plan`]: the part of each cycle that the buses need.
//! - [`imu`]: IMUs, and their mounts on the body.
//! - [`imu_load`]: the load of IMUs on CAN buses.
//!
//! Values only: no socket, no thread, no file and no clock.

#![forbid(unsafe_code)]

pub mod imu;
pub mod imu_load;
pub mod plan;
pub mod settings;
