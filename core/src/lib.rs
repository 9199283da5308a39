//! The robot's side of motord, over any [`Bus`](motord_bus::Bus) and any [`Clock`](clock::Clock).
//!
//! No socket, no thread, no file and no wall clock: time is an argument, and buses are a trait. The daemon runs this crate
//! on the machine; a test or another program runs it on virtual time.
//!
//! - [`settings`]: everything that was configured, checked. It, [`plan`] and [`joint`] are of the crate `motord-settings`.
//! - [`plan`]: the part of each cycle that the buses need.
//! - [`control`]: one command per motor and cycle, as pure decisions on (state, inputs, now).
//! - [`joint`]: the two sides of a joint, and the one transmission between them.
//! - [`drive`]: from commands to frames, and back.
//! - [`stopper`]: damps and stops the motors when nobody else does.
//! - [`cycle`]: wake, decide, transmit, collect, publish. [`clock`]: the time of the cycle.

#![forbid(unsafe_code)]

pub mod clock;
pub mod control;
pub mod cycle;
pub mod drive;
pub mod stopper;

pub use motord_settings::{joint, plan, settings};
