//! RobStride's private protocol over CAN, which its motors speak from the factory. Ids have 29
//! bits, and payloads have 8 bytes.
//!
//! Sources: the vendor's manuals of 2026-04-28 of RS00 to RS06 and EL05 (chapter "private
//! communication protocol"), its SampleProgram (`RS/Robstride01.cpp`), its Python SDK, motorbridge,
//! and the manual of the CyberGear, whose protocol is the same. None of them is confirmed on
//! hardware. docs/motors.md names the points in which they differ.
//!
//! | bits of the id | of a command | of a reply |
//! |---|---|---|
//! | 24 to 28 | type | type |
//! | 8 to 23 | data: the torque of a control frame, otherwise the host's id in the lower byte | status in the upper byte, the motor's id in the lower one |
//! | 0 to 7 | the motor's id | the host's id |
//!
//! - Every code has 16 bits, big endian. The values of parameters are little endian.
//! - Type 2 is the state, the answer to nearly every command. Faults and mode are in its id, so a
//!   state never lacks them.
//! - The answer to a request for the version also has type 2: its payload begins with 00 C4 56.
//! - A motor can be set to send its state unasked, as type 24, or as type 2 from older firmware.
//! - A frame of another protocol never has the form of a command: MIT has ids of 11 bits.

mod codes;
#[cfg(feature = "commissioning")]
pub(crate) mod commissioning;
#[cfg(feature = "drive")]
mod drive;
mod family;
mod frame;

pub use codes::{ControlCodes, WideScales};
#[cfg(feature = "drive")]
pub use drive::RobStrideDialect;
pub use family::{FAMILY, HOST_ID};
pub use frame::{Command, Feedback, Id, Mode, Reply, faults_of_report};

/// Largest position code of every model, rad: two turns in each direction.
pub const POSITION_END: f64 = 12.57;

/// Largest id of a motor. The smallest is 1.
pub const ID_MAX: u8 = 127;

/// Number of MIT among the protocols that a motor can speak from its next power-on.
pub const MIT: u8 = 2;

/// Indices of parameters. Source: the vendor's manuals of 2026-04-28, parameter list; the fault
/// register: the manual of the CyberGear.
pub mod parameter {
    /// Faults, as in a fault report.
    pub const FAULTS: u16 = 0x3022;
    /// The id of the host to which the motor sends, one byte.
    pub const HOST: u16 = 0x200B;
    /// Time without commands after which the motor disables itself: 20 000 is 1 s, 0 is never.
    pub const TIMEOUT: u16 = 0x7028;
    /// Number of units of [`TIMEOUT`] in a second.
    pub const TIMEOUT_HZ: u32 = 20_000;
    /// Voltage of the supply, V, a float.
    pub const SUPPLY_VOLTAGE: u16 = 0x701C;
}
