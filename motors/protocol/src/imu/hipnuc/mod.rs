//! HiPNUC IMUs: CH0x0, CH10x, HI04 to HI14.
//!
//! Sources:
//! - *User manual*: "CH0X0 series user manual" and "CH10X series user manual" V1.0 (Chinese),
//!   chapters binary serial protocol, AT commands, CAN protocol;
//! - *SDK*: the vendor's repository `hipnuc/products`, folders `drivers`, `examples` and
//!   `c/hipnuc`;
//! - *Command manual*: "Command and Programming Manual" Rev 1.7.1.
//!
//! Where they differ:
//! - **g.** The vendor's C decoder multiplies by 9.8, and the SDK of 2026 states that the firmware
//!   means 9.8 m/s² by 1 G. The vendor's Python decoder multiplies by 9.80665. This module takes
//!   9.8; the difference is 0.07 %.
//! - **Bytes 1 and 2 of a 0x91 frame** are reserved, or an id, in the user manuals. The SDK reads
//!   them as status bits. This module reports them as received.
//! - **Commands.** Firmware of the user manuals has `AT+ODR`, later firmware has `LOG`.
//!   [`command`] encodes both.
//!
//! The orientation is from the sensor to the world, and the acceleration is positive upward: in the
//! user manual's example frame, the measured acceleration of 1.06 G points up after the rotation.

pub mod can;
pub mod command;
pub mod serial;

/// Meaning of 1 G in the firmware, m/s². Source: SDK, `hipnuc_sample.h`.
const GRAVITY: f32 = 9.8;
/// One degree, rad.
const DEGREE: f32 = core::f32::consts::PI / 180.0;
