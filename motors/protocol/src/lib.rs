//! The motors' protocols: encoding and decoding of frames.
//!
//! The crate covers three documents of SteadyWin, in both directions. Motors of other vendors that
//! speak MIT are described by a [`profile`]. Sources named in these pages:
//! - *MIT document*: "SteadyWin MIT interface, in brief" (Chinese only);
//! - *GIM document*: "SteadyWin motor driver protocol specification", version 2.2, English and
//!   Chinese. Where the two disagree, this crate follows the Chinese original.
//!
//! They apply to SteadyWin's SDC101, SDC102 and SDC103 drivers. Other drivers sold under the GIM
//! name speak [`cansimple`], or protocols with the same leading bytes. A motor's protocol is therefore
//! declared, never inferred from its replies.
//!
//! - [`Family`]: one row of facts for each protocol of motors, and [`MotorProtocol`], its name in
//!   code.
//! - `drive`, with the feature of this name: commands and reports of a motor in a cycle, for every
//!   family. It uses the standard library.
//! - `commissioning`, with the feature of this name: transactions with motors, one at a time.
//! - [`mit`]: impedance control over CAN, with requests of 8 bytes and replies of 6 to 8.
//! - [`profile`]: the differences between vendors, as data. With the feature `models` it reads them
//!   from text files, of which the crate has one for each supported vendor.
//! - [`gim`]: the native commands over CAN, 8 bytes in both directions.
//! - [`cansimple`]: the CANSimple dialect of other SteadyWin drivers, with a node and a command in an id.
//! - [`odrive`]: ODrive's CANSimple of firmware 0.6, without impedances.
//! - [`myactuator`]: MyActuator's protocol of the RMD series, whose motors need no enable.
//! - [`robstride`]: RobStride's private protocol over CAN, with ids of 29 bits.
//! - [`field`] and [`scale`]: the codes of a quantity, and the ranges of a motor's codes.
//! - [`state`]: the codes of position, velocity and torque that every protocol reports.
//! - [`fault`]: faults in terms that all vendors share.
//! - [`register`]: the registers of Damiao motors.
//! - [`model`]: the vendors' data of each motor.
//! - [`imu`]: the frames of inertial measurement units, of three vendors.
//!
//! Units are SI: rad, rad/s, N·m, N·m/rad, N·m·s/rad. Other units are named where they occur. All
//! values are on the motor side: this crate does not apply signs and offsets of joints. No function
//! allocates, blocks, reads a clock or panics, whatever the bytes. Loops are bounded by the bytes
//! of a frame or by a table's length.

#![cfg_attr(not(any(feature = "drive", feature = "commissioning", feature = "models")), no_std)]
#![forbid(unsafe_code)]

pub mod cansimple;
#[cfg(feature = "commissioning")]
pub mod commissioning;
#[cfg(feature = "drive")]
pub mod drive;
pub mod error;
mod execution_time;
mod families;
mod family;
pub mod fault;
pub mod field;
pub mod gim;
pub mod imu;
#[cfg(feature = "commissioning")]
mod link;
pub mod mit;
pub mod model;
pub mod myactuator;
pub mod odrive;
pub mod profile;
pub mod register;
#[cfg(feature = "commissioning")]
mod reported;
pub mod robstride;
pub mod scale;
pub mod state;

pub use error::{DecodeError, EncodeError, Quantity};
#[cfg(feature = "drive")]
pub use families::AnyDialect;
pub use families::{FAMILIES, MotorProtocol};
pub use family::{AnswersOnLine, Family};
pub use fault::{FaultBits, Faults};
pub use field::Field;
pub use model::{DriveConstants, Model};
pub use profile::{Capabilities, Profile, SupplyReport};
pub use scale::{Ends, ScaleError, Scales};
pub use state::StateCodes;
