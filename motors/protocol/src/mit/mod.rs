//! The MIT protocol over CAN: a frame of 8 bytes commands an impedance, and a reply of 6 to 8 bytes
//! contains the state.
//!
//! The control frame is the same for every vendor of [`profile`](crate::profile); only the ranges
//! of its codes differ. The replies differ more, so [`Profile`](crate::Profile) decodes them.
//!
//! Interpretation of SteadyWin's MIT document:
//! - Codes are unsigned and big endian. Values are clamped first: with the printed formulas they
//!   would overflow into the neighbouring fields. The ranges of kp and kd, 0 to 500 and 0 to 5,
//!   follow from the printed factors.
//! - A control frame can equal a special frame (1.1): six bytes 0xFF, then 0xFB at the end, or
//!   seven and 0xFC, 0xFD or 0xFE. [`ControlCodes::pack`] never produces one. It never produces
//!   eight zeros, which a motor reads as full negative torque. The same guard covers the special
//!   frames of the other vendors, which all begin with six bytes 0xFF.
//! - A fault reply has the shape of a state (1.2), and only the request distinguishes them.
//!   Decoding therefore takes [`Asked`], and at most one request may be open per motor.
//! - Replies have 6 bytes. Relatives of these motors append up to two bytes, which are ignored.
//! - The reply's arbitration id is not documented: it is the driver's host id, configuration 0x13.
//! - The position spans about two turns in each direction. The motor's behaviour beyond is not
//!   documented.

mod command;
#[cfg(feature = "commissioning")]
pub(crate) mod commissioning;
mod decode;
#[cfg(feature = "drive")]
mod drive;
mod family;
#[cfg(feature = "drive")]
mod feedback;
#[cfg(feature = "drive")]
mod impedance;
#[cfg(feature = "commissioning")]
pub(crate) mod registers;
mod reply;

pub use crate::error::{DecodeError, EncodeError};
pub use command::{Command, CommandCodes, ControlCodes, Impedance, decode_command};
#[cfg(feature = "drive")]
pub use drive::MitDialect;
pub use family::FAMILY;
#[cfg(feature = "drive")]
pub use feedback::Feedback;
#[cfg(feature = "drive")]
pub(crate) use impedance::control_codes;
pub use reply::{Asked, Reply, State};
