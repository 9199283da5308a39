//! Checks the commands that motors receive against the invariants, for simulated runs and for logs.
//!
//! - [`run`]: a simulated run of the cycle. Compares every frame with the state that the cycle
//!   published.
//! - [`log`]: a log of candump, and the marks of the program that disturbed the robot.
//!
//! Both decode the same bytes with the same [`protocol`], and take their motors from the same
//! [`robot`] description. The codecs are written from the vendors' documents. They share no code
//! with the daemon or the simulator, which this crate checks.

pub mod imu;
pub mod log;
pub mod protocol;
pub mod robot;
pub mod run;
pub mod state;
pub mod vendor;
