//! Support for the tests of several crates.
//!
//! - [`robot`]: the cycle and simulated motors, on virtual time.

pub mod robot;
