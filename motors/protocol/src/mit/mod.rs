//! The MIT protocol over CAN: one frame of 8 bytes commands an impedance, 6 to 8 bytes answer with the state.
//!
//! The control frame is the same for every vendor of [`profile`](crate::profile); only the ranges of its codes differ.
//! Replies differ more, so it is the [`Profile`](crate::Profile) that decodes them.
//!
//! Readings of SteadyWin's MIT document:
//! - Codes are unsigned and big endian. Values are clamped first: the printed formulas would let them wrap into their
//!   neighbours. The ranges of kp and kd, 0 to 500 and 0 to 5, follow from the printed factors.
//! - A control frame can be one of the special frames (1.1): six bytes 0xFF, then 0xFB at the end, or seven and 0xFC,
//!   0xFD or 0xFE. [`ControlCodes::pack`] never makes one, nor the frame of eight zeros, which a motor reads as full
//!   negative torque. The same guard covers the special frames of the other vendors: all begin with six bytes 0xFF.
//! - A fault reply looks like a state (1.2): only what was asked tells them apart, so decoding takes what was
//!   [`Asked`], and at most one request may be open per motor.
//! - Replies have 6 bytes. Relatives of these motors append up to two of their own, which are ignored.
//! - The reply's arbitration id is not documented: it is the driver's host id, configuration 0x13.
//! - The position spans about two turns either way. What a motor does beyond is not documented.

mod command;
mod reply;

pub use crate::error::{DecodeError, EncodeError};
pub use command::{Command, CommandCodes, ControlCodes, Impedance, decode_command};
pub use reply::{Asked, Reply, State};
