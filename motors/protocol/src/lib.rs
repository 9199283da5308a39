//! The motors' protocols: vendor bytes to meaning, and back.
//!
//! Three documents of SteadyWin are covered, both directions of each; other vendors' motors that speak MIT are
//! [`profile`]s. The sources named in these pages are
//! - *MIT document*: "SteadyWin MIT interface, in brief" (Chinese only);
//! - *GIM document*: "SteadyWin motor driver protocol specification", version 2.2, English and Chinese. Where the two
//!   disagree, the Chinese original is followed.
//!
//! They apply to SteadyWin's SDC101, SDC102 and SDC103 drivers. Other drivers sold under the GIM name speak other protocols with
//! the same leading bytes, so a motor's protocol is declared, never guessed from what it answers.
//!
//! - [`mit`]: impedance control over CAN, 8 bytes there and 6 to 8 back.
//! - [`profile`]: what differs from vendor to vendor in it, as data.
//! - [`gim`]: the native commands over CAN, 8 bytes both ways.
//! - [`field`] and [`scale`]: how a quantity becomes a code, and what the codes of a motor are worth.
//! - [`state`]: the codes of position, velocity and torque that every protocol reports.
//! - [`fault`]: faults in words that all vendors share.
//! - [`model`]: what the vendors say of each motor.
//!
//! Units are SI: rad, rad/s, N·m, N·m/rad, N·m·s/rad; others are named where they occur. Everything is on the motor
//! side: signs and offsets of joints are not known here. Nothing in this crate allocates, blocks, reads a clock or
//! panics, whatever the bytes; loops are bounded by the eight bytes of a frame or by a table's length.

#![no_std]
#![forbid(unsafe_code)]

pub mod error;
pub mod fault;
pub mod field;
pub mod gim;
pub mod mit;
pub mod model;
pub mod profile;
pub mod scale;
pub mod state;

pub use error::{DecodeError, EncodeError, Quantity};
pub use fault::{FaultBits, Faults};
pub use field::Field;
pub use model::{DriveConstants, Model};
pub use profile::{Capabilities, MotorProtocol, Profile};
pub use scale::{ScaleError, Scales};
pub use state::StateCodes;
