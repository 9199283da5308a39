//! The robot's side of motord, over any [`Bus`](motord_bus::Bus) and any [`Clock`](clock::Clock).
//!
//! No socket, no thread, no file and no wall clock: time is an argument, and buses are a trait.
//! The daemon runs this crate on the machine; tests and other programs run it on virtual time.
//!
//! - [`settings`]: the checked configuration. [`settings`], [`plan`] and [`joint`] are re-exported
//!   from the crate `motord-settings`.
//! - [`plan`]: the part of each cycle that the buses need.
//! - [`control`]: one command per motor and cycle, as pure decisions on (state, inputs, now).
//! - [`imu`]: the samples of IMUs, and their mounts.
//! - [`imu_load`]: the load of IMUs on CAN buses.
//! - [`joint`]: the two sides of a joint, and the transmission between them.
//! - [`drive`]: converts commands to frames, and payloads to replies.
//! - [`stopper`]: damps and stops the motors when no cycle controls them.
//! - [`cycle`]: wake, decide, transmit, collect, publish. [`clock`]: the time of the cycle.

#![forbid(unsafe_code)]

pub mod clock;
pub mod control;
pub mod cycle;
pub mod drive;
pub mod stopper;

pub use motord_settings::{imu, imu_load, joint, plan, settings};
