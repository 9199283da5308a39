//! Inertial measurement units (IMUs): their frames, decoded to a [`Sample`] with SI units.
//!
//! | module | device | a sample is |
//! |---|---|---|
//! | [`hipnuc::serial`] | HiPNUC, UART or USB | one 0x91 frame |
//! | [`hipnuc::can`] | HiPNUC, CANopen | one frame for each quantity |
//! | [`damiao`] | Damiao DM-IMU-L1, CAN | one reply for each quantity |
//! | [`xsens`] | Xsens MTi, serial | one MTData2 message |
//!
//! [`SerialProtocol`] and [`SerialDecoder`] are those on a serial line as one type.
//!
//! `docs/imu-protocols.md` lists each field with its unit, its scale and its source. None of the
//! facts was confirmed on hardware.
//!
//! Conventions of every decoder:
//! - The axes are the sensor's. This module does not apply the mounting of the sensor.
//! - The world is east, north, up, or any frame whose z points up where a device has no compass.
//! - The acceleration is the specific force: at rest it is +9.81 m/s² on the axis that points up.
//! - A sample never combines two moments: its values come from one frame, or from frames whose
//!   order and time show that they belong together. A sample whose checksum is wrong is never
//!   returned.
//! - Values are finite, and a quaternion has the norm 1. Anything else is a [`SampleError`].
//!
//! The stream decoders have a bounded buffer. After damaged bytes they return the next intact
//! sample with its last byte: each byte is examined as the end of a sample, whatever came before.

mod can;
pub mod damiao;
mod error;
pub mod hipnuc;
mod request;
mod sample;
mod sequence;
mod stream;
mod window;
pub mod xsens;

pub use can::{CanAddress, CanDecoder, CanDevice, CanProtocol};
pub use error::{SampleError, SampleField};
pub use request::CanRequest;
pub use sample::{DeviceTime, Quaternion, Sample};
pub use sequence::{Measured, Parts};
pub use stream::{BITS_PER_BYTE, SerialDecoder, SerialProtocol};
