//! Configuration files: what they say, what `motord check` says about them, and how `motord init` writes one.

mod arbitrary;
mod arming;
mod document;
mod init;
mod ipc_schedule;
mod mistakes;
mod physics;
mod shipped;
