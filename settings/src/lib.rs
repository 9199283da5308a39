//! The settings of `motord-core` and the joints they speak of. Core re-exports both modules: most programs import them from there.
//!
//! - [`settings`]: everything that was configured, checked.
//! - [`joint`]: the two sides of a joint, and the one transmission between them.
//!
//! Values only: no socket, no thread, no file and no clock.

#![forbid(unsafe_code)]

pub mod joint;
pub mod settings;
