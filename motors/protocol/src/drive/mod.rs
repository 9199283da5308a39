//! Driving a motor in a cycle, for every family.
//!
//! - [`Command`] and [`Reported`]: the words between a controller and a drive, on the joint's side.
//! - [`Transmission`]: converts between the sides of joint and motor.
//! - [`Dialect`]: one family's frames for commands, and what it reads from replies.
//!   [`AnyDialect`](crate::AnyDialect) has every family.
//!
//! A [`Dialect`] does not decide which request a reply answers. It returns the [`Shape`] of the
//! reply, and its caller, who knows the open [`Question`], decides.
//!
//! Real-time: after [`AnyDialect::new`](crate::AnyDialect::new) nothing here allocates, blocks,
//! loops or calls the system.

mod addresses;
mod command;
mod dialect;
mod joint;

pub use addresses::Addresses;
pub use command::{Command, Question, Reported, Shape, Status, Supply};
pub(crate) use dialect::dispatch;
pub use dialect::{Arrived, Dialect, DriveSettings, UnpromptedFrame};
pub(crate) use joint::Unwrap;
pub use joint::{Impedance, JointSide, Measured, MotorSide, Setpoint, Transmission};
