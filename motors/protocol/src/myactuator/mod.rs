//! MyActuator's protocol of the RMD series over CAN, with ids of 11 bits.
//!
//! Sources: MyActuator's protocol document V4.2 (single-motor commands, and motion mode in section 5),
//! the driver myactuator_rmd by T. Flatscher, and a published driver for V4.3. None of them is
//! confirmed on hardware. docs/motors.md names the points in which they differ.
//!
//! - A command to motor `id` has the id 0x140 + id, and its answer 0x240 + id. Both have eight bytes, of
//!   which the first names the command. Values are little endian.
//! - An impedance has the id 0x400 + id, and its answer 0x500 + id. Its fields are those of MIT, big
//!   endian. There are no special frames: eight bytes 0xFF are full position, velocity and torque.
//! - **A motor needs no enable.** It follows the first impedance that it receives, also one that
//!   waited for its power. The status 0x9A is asked before the first one is sent.
//! - An answer to an impedance has no faults. Only the status has them.

#[cfg(feature = "commissioning")]
pub(crate) mod commissioning;
#[cfg(feature = "drive")]
mod drive;
mod family;
mod frame;

#[cfg(feature = "drive")]
pub use drive::MyActuatorDialect;
pub use family::FAMILY;
pub use frame::{Command, MotorStatus, Reply};

/// Largest id of a motor. The smallest is 1.
pub const MOTORS_MAX: u8 = 32;
