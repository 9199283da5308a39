//! The native protocol: one frame of 8 bytes asks, one of 8 bytes answers. CAN carries the frame as it is; on serial
//! lines a header of four bytes precedes it, which this crate does not know.
//!
//! Readings of the GIM document, section 3.2 if not said otherwise:
//! - Integers and floats are little endian. The formulas of 3.2.3 and 3.2.14 that use DATA2 twice are misprints.
//! - Flux weakening, over temperature and protocol over CAN are integers: a page break of Table 7 puts them under float
//!   in the English edition only.
//! - Calibration (3.2.18) asks with 0xB5; its reply is printed as 0xB4, which is also an indicator's. Both are accepted,
//!   0xB4 only while a calibration is open ([`Pending`]).
//! - Where a reply tells a failure, its other values are not used.
//! - Temperature is a signed byte, °C, as the vendor's sample code has it.
//! - A float that is NaN or infinite has no meaning, in either direction.
//! - Bytes printed NULL are free. A frame padded with zeros is full negative torque to a motor that is in MIT mode, so
//!   [`Command::encode_mit_safe`] pads with what such a motor takes as no stiffness, no damping and no torque.
//! - A reply names neither the motor nor, over CAN, the request: the host keeps one request open and compares the command
//!   and the number in it ([`Reply::answers`]).

mod command;
mod configuration;
mod indicator;
mod parameter;
mod reply;
mod result;
mod value;

pub use crate::error::DecodeError;
pub use command::{Calibration, Command, CommandCode, decode_command};
pub use configuration::{
    Access, CONFIGURATION, ConfigurationItem, ConfigurationKey, Effective, single_turn_position,
};
pub use indicator::{INDICATORS, Indicator, RPM};
pub use parameter::{PARAMETERS, Parameter};
pub use reply::{Pending, Reply, State, decode_reply, repeats};
pub use result::{Outcome, Refusal};
pub use value::{ExecutionTime, Finite, Value, ValueType};
