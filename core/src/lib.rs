//! The robot's side of motord, over any [`Bus`](motord_bus::Bus) and any
//! [`Clock`](motord_bus::Clock).
//!
//! No socket, no thread, no file and no wall clock: time is an argument, and buses are a trait.
//! The daemon runs this crate on the machine; tests and other programs run it on virtual time.
//!
//! - [`control`]: one command per motor and cycle, as pure decisions on (state, inputs, now).
//! - [`drive`]: converts commands to frames, and payloads to replies.
//! - `sensor`: the sensors of a CAN bus, their frames and readings.
//! - [`stopper`]: damps and stops the motors when no cycle controls them.
//! - [`cycle`]: wake, decide, transmit, collect, publish.
//!
//! The checked configuration, the plan of the buses and the two sides of a joint are in
//! [`motord_settings`].

#![forbid(unsafe_code)]

pub mod control;
pub mod cycle;
pub mod drive;
mod sensor;
pub mod stopper;
