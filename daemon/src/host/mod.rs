//! This machine: the log, and panics on request.

pub mod log;
#[cfg(feature = "panic-on-request")]
pub(crate) mod panics;
