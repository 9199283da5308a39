//! The daemon that owns every motor of a legged robot.
//!
//! - [`config`]: what the file says, checked. Text stops here.
//! - [`plan`] and [`check`]: how much of each cycle the buses need, before any is opened.
//! - [`control`]: what each motor is told, as pure decisions on (state, inputs, now).
//! - [`joint`] and [`drive`]: from joints to motors, from commands to frames, and back.
//! - [`cycle`]: wake, decide, transmit, collect, publish, on a [`clock`] that may be a test's.
//! - [`exchange`]: clients, through shared memory.
//! - [`telemetry`]: histograms, and what the [`log`] is told.
//! - [`deadman`], [`heartbeat`] and [`safe_stop`]: what stops the motors when the daemon cannot.
//! - [`rt`]: what makes a thread real-time. [`buses`], [`reopen`], [`threads`] and [`run`]: putting it all together.
//!   [`systemd`] is told how it goes.

pub mod buses;
pub mod check;
pub mod clock;
pub mod config;
pub mod control;
pub mod cycle;
pub mod deadman;
pub mod drive;
pub mod exchange;
pub mod heartbeat;
pub mod joint;
#[allow(unsafe_code, reason = "system calls that no safe crate offers")]
mod kernel;
pub mod log;
#[cfg(feature = "panic-on-request")]
mod panics;
pub mod plan;
pub mod reopen;
pub mod roster;
pub mod rt;
pub mod run;
pub mod safe_stop;
pub mod systemd;
pub mod telemetry;
pub mod threads;
