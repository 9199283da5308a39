//! The one invariant checker: it judges what motors hear, whoever recorded it.
//!
//! - [`run`]: a simulated run of the cycle. Every frame is compared with what the cycle published.
//! - [`log`]: a log of candump and the marks of whoever disturbed the robot.
//!
//! Both read the same bytes with the same [`codec`], those of native motors with [`gim`], and know their motors from the same
//! [`robot`] description. The codecs are written from the vendors' documents and share no code with the daemon or the simulator,
//! which are judged here.

pub mod codec;
pub mod gim;
pub mod log;
pub mod robot;
pub mod run;
pub mod state;
pub mod vendor;
