//! The daemon that owns every motor of a legged robot: the shell around `motord-core`.
//!
//! - [`commands`]: `run`, `check`, `init`. `deadman` and `safe-stop` are `motord-deadman`.
//! - [`arming`]: whether the motors are the configured ones.
//! - [`buses`]: opens the buses of a configuration, and opens them again.
//! - [`simulation`]: faults for simulated buses.
//! - [`plant`]: another process that moves the joints of a simulated robot.
//! - [`imus`]: the sources of the samples of IMUs.
//! - [`ipc`]: clients, through shared memory.
//! - [`telemetry`]: histograms, and the lines of the log.
//! - [`housekeeping`]: dead clients, the runtime directory, the configuration file.
//! - [`emergency_stop`]: the stop that waits behind nothing.
//! - [`host`]: this machine. [`threads`]: wires it all together.

pub mod arming;
pub mod buses;
/// The commands of `motord`, a file each.
pub mod commands {
    pub mod check;
    pub mod init;
    pub mod run;
}
pub mod emergency_stop;
pub mod host;
pub mod housekeeping;
pub mod imus;
pub mod ipc;
pub mod plant;
pub mod run_error;
pub mod simulation;
pub mod telemetry;
pub mod threads;
