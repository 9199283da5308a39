//! The CANSimple dialect of SteadyWin's SDC104, GDS68 and GDZ drivers over CAN. Ids have 11 bits: the
//! node in the upper six, the command in the lower five.
//!
//! Sources: chapter 4 of SteadyWin's manual of the GIM6010-8, SteadyWin's C SDK "MWMotor", and
//! four published drivers of users. The bits of the errors are those of ODrive 0.5, from which the
//! firmware descends. None of them is confirmed on hardware. docs/motors.md names the points in which
//! they differ.
//!
//! - Values are little endian. Only the impedance command 0x008 and its reply are big endian. Their
//!   fields have the widths of MIT, with fixed ranges at the output shaft.
//! - Only 0x003, 0x008, 0x009 and 0x017 are answered, with the id of the request.
//! - The driver sends a heartbeat every 100 ms and the estimates of its encoder every 10 ms. The
//!   estimates are those of the rotor.
//! - A frame of another protocol may have the form of a command: a node obeys 32 ids.
//! - 0x01F saves the configuration. To an ODrive Pro, it means the boot loader.

#[cfg(feature = "commissioning")]
pub(crate) mod commissioning;
#[cfg(feature = "drive")]
mod drive;
mod family;
mod faults;
pub(crate) mod frame;

#[cfg(feature = "drive")]
pub use drive::CanSimpleDialect;
pub use family::FAMILY;
pub use faults::Errors;
pub use frame::{AxisState, Command, Estimates, Heartbeat, Id, Reply, ReportedState};

use crate::scale::Ends;

/// Largest node id.
pub const NODE_MAX: u8 = 63;

/// The values of the largest codes, the same for every model, at the output shaft. One user's driver
/// multiplies the torque by the gear ratio.
pub const ENDS: Ends = Ends::new(12.5, 65.0, 50.0);
