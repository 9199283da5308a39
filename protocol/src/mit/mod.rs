//! The MIT protocol over CAN: one frame of 8 bytes commands an impedance, 6 bytes tell the state.
//!
//! Readings of the MIT document:
//! - Codes are unsigned and big endian. Values are clamped first: the printed formulas would let them wrap into their
//!   neighbours. The ranges of kp and kd, 0 to 500 and 0 to 5, follow from the printed factors.
//! - A control frame can be one of the special frames (1.1): six bytes 0xFF, then 0xFB at the end, or seven and 0xFC,
//!   0xFD or 0xFE. [`ControlCodes::pack`] never makes one, nor the frame of eight zeros, which a motor reads as full
//!   negative torque.
//! - A fault reply looks like a state (1.2): only what was asked tells them apart, so [`decode_reply`] takes it, and at
//!   most one request may be open per motor.
//! - Replies have 6 bytes. Relatives of these motors append up to two of their own, which are ignored.
//! - The reply's arbitration id is not documented: it is the driver's host id, configuration 0x13.
//! - The position spans about two turns either way. What a motor does beyond is not documented.

mod command;
mod reply;

pub use crate::error::{DecodeError, EncodeError};
pub use crate::state::{POSITION, VELOCITY};
pub use command::{Command, CommandCodes, ControlCodes, Impedance, KD, KP, decode_command};
pub use reply::{Asked, Reply, State, decode_reply};
