//! This machine: real-time set-up, system calls, systemd, the log.

pub mod clock;
#[allow(unsafe_code, reason = "system calls that no safe crate offers")]
pub(crate) mod kernel;
pub mod log;
#[cfg(feature = "panic-on-request")]
pub(crate) mod panics;
pub mod process;
pub mod rt;
pub mod systemd;
