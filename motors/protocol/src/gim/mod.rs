//! The native protocol: a request of one frame of 8 bytes, and a reply of one frame of 8 bytes. CAN
//! carries the frame unchanged. Serial lines add a header of four bytes, which this crate does not
//! handle.
//!
//! Interpretation of the GIM document, section 3.2 unless noted otherwise:
//! - Integers and floats are little endian. The formulas of 3.2.3 and 3.2.14 that use DATA2 twice
//!   are misprints.
//! - Flux weakening, over temperature and protocol over CAN are integers. Only the English edition
//!   lists them under float, because of a page break in Table 7.
//! - A calibration (3.2.18) is requested with 0xB5. Its reply is printed as 0xB4, which is also
//!   that of an indicator. The decoder accepts both, and 0xB4 only while a calibration is open
//!   ([`Pending`]).
//! - When a reply reports a failure, its other values are not used.
//! - Temperature is a signed byte, °C, as in the vendor's sample code.
//! - A float that is NaN or infinite is invalid, in both directions.
//! - Bytes printed NULL are free. A motor in MIT mode reads a frame padded with zeros as full
//!   negative torque. [`Command::encode_mit_safe`] therefore pads with bytes that such a motor
//!   reads as no stiffness, damping and torque.
//! - A reply identifies neither the motor nor, over CAN, the request. The host keeps one request
//!   open and compares the command and the number in it ([`Reply::answers`]).

mod command;
#[cfg(feature = "commissioning")]
pub(crate) mod commissioning;
mod configuration;
#[cfg(feature = "drive")]
mod drive;
mod family;
mod indicator;
mod parameter;
mod reply;
mod result;
mod value;

pub use crate::error::DecodeError;
pub use crate::execution_time::ExecutionTime;
pub use command::{Calibration, Command, CommandCode, decode_command};
pub use configuration::{
    Access, CONFIGURATION, ConfigurationItem, ConfigurationKey, Effective, single_turn_position,
};
#[cfg(feature = "drive")]
pub use drive::GimDialect;
pub use family::FAMILY;
pub use indicator::{INDICATORS, Indicator, RPM};
pub use parameter::{PARAMETERS, Parameter};
pub use reply::{Pending, Reply, State, decode_reply, repeats};
pub use result::{Outcome, Refusal};
pub use value::{Finite, Value, ValueType};
