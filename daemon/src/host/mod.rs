//! This machine: the log, the watchdog of systemd, and panics on request.

pub mod log;
#[cfg(feature = "panic-on-request")]
pub(crate) mod panics;
pub mod watchdog;
