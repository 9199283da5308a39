//! Support for the tests of several crates.
//!
//! - [`robot`]: the cycle and simulated motors, on virtual time.
//! - [`conventions`]: IMUs of other conventions.
//! - [`daemon`]: daemons as processes. [`programs`]: the programs that cargo built.
//! - [`tmux`]: a terminal for programs that draw on the whole screen.

pub mod conventions;
pub mod daemon;
pub mod programs;
pub mod robot;
pub mod tmux;
