//! The settings of `motord-core`.
//!
//! - [`settings`]: the checked configuration.
//! - [`defaults`]: the values that a configuration need not name.
//! - [`plan`]: the part of each cycle that the buses need.
//! - [`imu_load`]: the load of IMUs on CAN buses.
//! - [`nodes`]: the motors and sensors of a bus, for its transport.
//! - [`sensor`]: the sensors, and the frames of those on CAN buses.
//!
//! Values only: no socket, no thread, no file and no clock.

#![forbid(unsafe_code)]

pub mod defaults;
pub mod imu_load;
pub mod nodes;
pub mod plan;
pub mod sensor;
pub mod settings;
