//! The daemon that owns every motor of a legged robot: the shell around `motord-core`.
//!
//! - [`commands`]: `run`, `check`, `safe-stop`.
//! - [`arming`]: whether the motors are the configured ones.
//! - [`buses`]: opens the buses of a configuration, and opens them again.
//! - [`simulation`]: faults for simulated buses.
//! - [`ipc`]: clients, through shared memory.
//! - [`telemetry`]: histograms, and the lines of the log.
//! - [`deadman`]: stops the motors when the daemon cannot.
//! - [`emergency_stop`]: the stop that waits behind nothing.
//! - [`host`]: this machine. [`threads`]: wires it all together.

pub mod arming;
pub mod buses;
pub mod commands;
pub mod deadman;
pub mod emergency_stop;
pub mod host;
pub mod ipc;
pub mod run_error;
pub mod simulation;
pub mod telemetry;
pub mod threads;
