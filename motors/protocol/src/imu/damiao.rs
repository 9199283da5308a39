//! Damiao DM-IMU-L1 on a CAN bus: a request for each quantity, and a reply to each.
//!
//! | reply byte | 0 | 1 | 2, 3 | 4, 5 | 6, 7 |
//! |---|---|---|---|---|---|
//! | acceleration | 1 | temperature, °C | x | y | z |
//! | angular velocity | 2 | 0 | x | y | z |
//! | angles | 3 | 0 | pitch, ±90° | yaw, ±180° | roll, ±180° |
//! | quaternion | 4 | w, x, y, z with 14 bits each, most significant first, ±1 | | | |
//!
//! Codes are unsigned: the smallest stands for the lower end of the range, the largest for the
//! upper. Those with 16 bits are little endian. The reply has the master id, 0x11 for the device 1
//! in the vendor's samples.
//!
//! Sources: *manual*, "DM-IMU-L1 user manual" V1.1 of 2025-04-03 (Chinese), chapter CAN
//! communication and appendices 2 and 3; *log*, "firmware update log" V1021 to V1023; *sample*, the
//! vendor's repository `dmBots/DM-IMU`, `dm_imu.c` for firmware 1024. Where they differ:
//! - **Request and range** depend on the firmware: see [`Profile`].
//! - **Codes**: the manual's text says -32768 to 32768. Its functions, and the sample, read
//!   unsigned codes.
//! - **Quaternion**: the manual's table gives w the bits 7 to 2 of byte 2. Its function and the
//!   sample mask bit 2 off, so their w is too low by one code (0.00012) in half of the cases. This
//!   module follows the table.
//! - **Temperature**: the manual says that the byte is the value itself, not whether it is signed.
//!   This module reads it signed: a device in the cold would otherwise report more than 200 °C.
//!
//! No source states the world's axes or the sign of the acceleration. The device reports its
//! calibrated accelerometer (BMI088) without a filter, which measures the specific force.

use crate::field::Field;
use crate::imu::error::SampleError;
use crate::imu::request::CanRequest;
use crate::imu::sample::{Quaternion, Sample};
use crate::imu::sequence::Measured;
use crate::imu::sequence::{Parts, Sequence};

/// Bytes of a reply.
const REPLY_LEN: usize = 8;
/// Id of every request, up to firmware 1022.
const SHARED_ID: u16 = 0x6FF;
/// First byte of requests, and of replies that confirm one, from firmware 1024 on.
const MARK: u8 = 0xCC;

/// Angular velocity, rad/s.
const VELOCITY: Field = Field::symmetric(16, 34.88);
/// Pitch, °.
const PITCH: Field = Field::symmetric(16, 90.0);
/// Yaw and roll, °.
const YAW_ROLL: Field = Field::symmetric(16, 180.0);
/// Parts of a quaternion.
const PART: Field = Field::symmetric(14, 1.0);
/// One degree, rad.
const DEGREE: f64 = core::f64::consts::PI / 180.0;

/// The registers with data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Register {
    /// Acceleration and temperature.
    Acceleration = 1,
    /// Angular velocity.
    AngularVelocity = 2,
    /// Roll, pitch and yaw.
    Angles = 3,
    /// Quaternion.
    Orientation = 4,
}

/// The form of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum RequestForm {
    /// Id 0x6FF, four bytes. Source: manual.
    SharedId,
    /// The device's id, the same four bytes. Source: log, V1023.
    DeviceId,
    /// The device's id, eight bytes. Settings can be written. Source: sample.
    Registers,
}

/// The differences between versions of the firmware.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Profile {
    /// Name, as in a configuration.
    pub name: &'static str,
    /// Form of the requests.
    pub request: RequestForm,
    /// Acceleration, m/s².
    pub acceleration: Field,
}

/// Firmware up to 1022: requests with id 0x6FF, ±58.8 m/s² (6 g).
pub const FIRMWARE_1022: Profile =
    Profile { name: "damiao-1022", request: RequestForm::SharedId, acceleration: Field::symmetric(16, 58.8) };
/// Firmware 1023: ±235.2 m/s² (24 g).
pub const FIRMWARE_1023: Profile = Profile {
    name: "damiao-1023",
    request: RequestForm::DeviceId,
    acceleration: Field::symmetric(16, 235.2),
};
/// Firmware from 1024 on.
pub const FIRMWARE_1024: Profile = Profile {
    name: "damiao-1024",
    request: RequestForm::Registers,
    acceleration: FIRMWARE_1023.acceleration,
};
/// Every profile.
pub const PROFILES: &[&Profile] = &[&FIRMWARE_1022, &FIRMWARE_1023, &FIRMWARE_1024];

/// A reply of the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reply {
    /// A quantity.
    Measured {
        /// Its value.
        measured: Measured,
        /// Temperature, °C, with an acceleration.
        temperature_celsius: Option<i8>,
    },
    /// Confirms a request, from firmware 1024 on. Source: a driver that cites the manual V1.2.
    Confirmed {
        /// Register of the request.
        register: u8,
        /// 0: done.
        code: u8,
    },
}

impl Profile {
    /// Returns the profile with this name.
    #[must_use]
    pub fn by_name(name: &str) -> Option<&'static Self> {
        PROFILES.iter().find(|profile| profile.name == name).copied()
    }

    /// Returns the profile of this version of the firmware.
    #[must_use]
    pub const fn of_firmware(version: u16) -> &'static Self {
        match version {
            0..=1022 => &FIRMWARE_1022,
            1023 => &FIRMWARE_1023,
            1024.. => &FIRMWARE_1024,
        }
    }

    /// Returns the request for `register` of the device `can_id`.
    #[must_use]
    pub fn request(&self, can_id: u16, register: Register) -> CanRequest {
        let ([low, high], register) = (can_id.to_le_bytes(), register as u8);
        match self.request {
            RequestForm::SharedId => CanRequest::new(SHARED_ID, [low, high, register, MARK]),
            RequestForm::DeviceId => CanRequest::new(can_id, [low, high, register, MARK]),
            RequestForm::Registers => access(can_id, register, 0, 0),
        }
    }

    /// Decodes a reply.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    ///
    /// # Errors
    ///
    /// There are not exactly 8 bytes, the first is not that of a reply, or the quaternion is no
    /// rotation.
    pub fn decode(&self, payload: &[u8]) -> Result<Reply, SampleError> {
        let length = SampleError::Length { least: REPLY_LEN, most: REPLY_LEN, received: payload.len() };
        let [register, second, rest @ ..]: [u8; REPLY_LEN] = payload.try_into().map_err(|_| length)?;
        let [a, b, c] = [0, 2, 4].map(|at| u16::from_le_bytes([rest[at], rest[at + 1]]));
        let vector = |field: Field| [a, b, c].map(|code| field.decode(code) as f32);
        let degrees = |field: Field, code| (field.decode(code) * DEGREE) as f32;
        let (measured, temperature_celsius) = match register {
            1 => (Measured::Acceleration(vector(self.acceleration)), Some(second as i8)),
            2 => (Measured::AngularVelocity(vector(VELOCITY)), None),
            3 => (Measured::Angles([degrees(YAW_ROLL, c), degrees(PITCH, a), degrees(YAW_ROLL, b)]), None),
            4 => (Measured::Orientation(quaternion(second, rest)?), None),
            MARK => return Ok(Reply::Confirmed { register: second, code: rest[1] }),
            received => return Err(SampleError::UnknownRegister { received }),
        };
        Ok(Reply::Measured { measured, temperature_celsius })
    }

    /// Encodes a reply as the device would, for simulated devices and tests. Values saturate, and
    /// one that is not finite has the code 0.
    #[must_use]
    pub fn encode(&self, reply: &Reply) -> [u8; REPLY_LEN] {
        let code = |field: Field, value: f32| field.encode(value.into()).unwrap_or_default();
        let degrees = |field: Field, value: f32| field.encode(f64::from(value) / DEGREE).unwrap_or_default();
        let (measured, temperature) = match *reply {
            Reply::Measured { measured, temperature_celsius } => (measured, temperature_celsius),
            Reply::Confirmed { register, code } => return [MARK, register, 0, code, 0, 0, 0, 0],
        };
        let [second] = temperature.unwrap_or_default().to_le_bytes();
        match measured {
            Measured::Acceleration(value) => {
                join(1, second, value.map(|value| code(self.acceleration, value)))
            }
            Measured::AngularVelocity(value) => join(2, 0, value.map(|value| code(VELOCITY, value))),
            Measured::Angles([roll, pitch, yaw]) => {
                join(3, 0, [degrees(PITCH, pitch), degrees(YAW_ROLL, yaw), degrees(YAW_ROLL, roll)])
            }
            Measured::Orientation(value) => {
                let codes = value.parts().map(|part| u64::from(code(PART, part)));
                let word = codes.into_iter().fold(4, |word, code| word << 14 | code);
                word.to_be_bytes()
            }
        }
    }
}

/// Decodes four codes of 14 bits.
fn quaternion(second: u8, rest: [u8; 6]) -> Result<Quaternion, SampleError> {
    let [b, c, d, e, f, g] = rest;
    let word = u64::from_be_bytes([0, second, b, c, d, e, f, g]);
    let code = |shift: u32| (word >> shift) as u16 & PART.code_max();
    Quaternion::new([42, 28, 14, 0].map(|shift| PART.decode(code(shift)) as f32))
}

fn join(register: u8, second: u8, codes: [u16; 3]) -> [u8; REPLY_LEN] {
    let [[a, b], [c, d], [e, f]] = codes.map(u16::to_le_bytes);
    [register, second, a, b, c, d, e, f]
}

/// A setting that firmware from 1024 on can change. It lasts until a power cycle unless it is
/// saved. Source: sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Setting {
    /// Time between the samples that the device sends without requests, ms.
    PeriodMs(u32),
    /// The device sends samples without requests.
    IsActive(bool),
    /// Id of the device.
    CanId(u8),
    /// Id of its replies.
    MasterId(u8),
    /// Stores the settings.
    Save,
    /// Restarts the device.
    Restart,
}

impl Setting {
    /// Returns the request that changes the setting of the device `can_id`.
    #[must_use]
    pub fn request(self, can_id: u16) -> CanRequest {
        let (register, data) = match self {
            Self::Restart => (0x00, 0),
            Self::PeriodMs(period) => (0x0A, period),
            Self::IsActive(is_active) => (0x0B, is_active.into()),
            Self::CanId(id) => (0x0D, id.into()),
            Self::MasterId(id) => (0x0E, id.into()),
            Self::Save => (0xFE, 0),
        };
        access(can_id, register, 1, data)
    }
}

/// Returns a request of firmware 1024: `action` is 0 to read and 1 to write.
fn access(can_id: u16, register: u8, action: u8, data: u32) -> CanRequest {
    let [a, b, c, d] = data.to_le_bytes();
    CanRequest::new(can_id, [MARK, register, action, 0xDD, a, b, c, d])
}

/// Combines the replies of one device into samples. Send the requests of a sample in the order of
/// [`Parts::in_order`].
#[derive(Debug, Clone)]
pub struct Decoder {
    profile: &'static Profile,
    sequence: Sequence,
    temperature_celsius: Option<f32>,
}

impl Decoder {
    /// Returns a decoder for samples with these `parts`, whose replies arrive within `within_us`,
    /// µs: half of the period of the requests.
    #[must_use]
    pub fn new(profile: &'static Profile, parts: Parts, within_us: u64) -> Self {
        Self { profile, sequence: Sequence::new(parts, within_us), temperature_celsius: None }
    }

    /// Drops the sample that is being received: the next frames belong to another one.
    pub const fn drop_sample(&mut self) {
        self.sequence.drop_sample();
    }

    /// Takes the payload of a frame with the device's master id that arrived at `at_us`, by any
    /// clock. Returns the sample that it completes. Confirmations and angles are ignored. A sample
    /// with an acceleration has its temperature.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    ///
    /// # Errors
    ///
    /// The payload is no reply, or a reply of the sample is lost: see [`SampleError::Incomplete`].
    /// The sample is dropped, and reported once.
    pub fn push(&mut self, payload: &[u8], at_us: u64) -> Result<Option<Sample>, SampleError> {
        let reply = self.profile.decode(payload).inspect_err(|_| self.sequence.drop_sample())?;
        let Reply::Measured { measured, temperature_celsius } = reply else { return Ok(None) };
        if let Measured::Acceleration(_) = measured {
            self.temperature_celsius = temperature_celsius.map(f32::from);
        }
        let temperature_celsius = self.temperature_celsius;
        let sample = self.sequence.push(measured, at_us)?;
        Ok(sample.map(|sample| match sample.acceleration {
            Some(_) => Sample { temperature_celsius, ..sample },
            None => sample,
        }))
    }
}
