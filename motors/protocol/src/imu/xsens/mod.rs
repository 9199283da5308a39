//! Xsens MTi 1, 10, 100 and 600 series on a serial port: MTData2 messages.
//!
//! | byte | meaning |
//! |---|---|
//! | 0, 1 | 0xFA, bus id: 0xFF for the device at the port |
//! | 2 | message: 0x36 is MTData2 |
//! | 3 | length of the data, 0 to 254; 255: a `u16` with 255 to 2048 follows |
//! | 4 | data |
//! | last | checksum: the sum of all bytes but the first is 0 modulo 256 |
//!
//! The data of MTData2 are items: identifier (`u16`), size (`u8`), value. All numbers are big
//! endian.
//!
//! | identifier | value |
//! |---|---|
//! | 0x0810 | temperature, °C |
//! | 0x1020 | packet counter, `u16` |
//! | 0x1060 | sample time, `u32`, 10 000 ticks in a second |
//! | 0x2010 | quaternion w, x, y, z |
//! | 0x4020 | acceleration x, y, z, m/s² |
//! | 0x8020 | rate of turn x, y, z, rad/s |
//! | 0xE020 | status bits, `u32`: bit 0 self-test passed, bit 1 filter valid, bits 8 to 16 clipping |
//!
//! The lower four bits of an identifier are its format. Bits 0 and 1 are the precision: `f32` (0),
//! fixed point 12.20 (1), fixed point 16.32 (2), `f64` (3). Fixed point 16.32 has six bytes: first
//! the fraction (`u32`), then the integer (`i16`). Bits 2 and 3 are the coordinate system of an
//! orientation: ENU (0), NED (1), NWU (2). The decoder converts NED and NWU to ENU. Acceleration
//! and rate of turn are along the sensor's axes in any case.
//!
//! Sources: *MT low level communication protocol*, MT0101P, revisions Y and 2019.A, chapters
//! messages and MTData2; the vendor's `xsdataidentifier.h` and `xsmessage.c`. They agree.
//!
//! A message with another bus id is from a device behind an Xbus master: the decoder names it.
//!
//! Not decoded: rotation matrix and Euler angles, and the high-rate outputs 0x4040 and 0x8040,
//! which have messages of their own.
//!
//! The crate `xsens-mti` 0.7 decodes neither the quaternion nor the temperature, returns
//! fixed-point numbers as unsigned integers, and reads eight bytes of each 16.32. Where it can
//! decode, both agree (docs/imu-protocols.md).

pub mod command;
mod decoder;
mod item;

pub use decoder::{Decoder, MESSAGE_LEN_MAX, SAMPLE_LEN_MIN, encode};
