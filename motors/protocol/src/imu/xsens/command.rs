//! Messages that select the outputs and their rate. Source: MT low level communication protocol,
//! MT0101P, chapters "GoToConfig", "SetOutputConfiguration" and "GoToMeasurement".
//!
//! Send [`GO_TO_CONFIG`], then [`outputs`], then [`GO_TO_MEASUREMENT`]. The device confirms each
//! with the message id plus one, and stores the outputs. On a serial port a device has no id. A
//! baud rate ([`set_baud`]) acts after [`RESET`]; its codes are those of the vendor's
//! `xsbaudcode.h`.

use super::decoder::{MESSAGE_LEN_MAX, checksum};
use super::item;
use crate::imu::window::Window;

/// Stops the measurements, and permits settings.
pub const GO_TO_CONFIG: [u8; 5] = [0xFA, 0xFF, 0x30, 0x00, 0xD1];
/// Starts the measurements.
pub const GO_TO_MEASUREMENT: [u8; 5] = [0xFA, 0xFF, 0x10, 0x00, 0xF1];

/// Restarts the device, as a new baud rate needs.
pub const RESET: [u8; 5] = [0xFA, 0xFF, 0x40, 0x00, 0xC1];

/// Message id of an error; its data is a code.
const ERROR: u8 = 0x42;
/// Preamble and bus id.
const START: [u8; 2] = [0xFA, 0xFF];
/// Bytes around the data.
const AROUND: usize = 5;
/// Codes of the baud rates.
const BAUDS: [(u32, u8); 11] = [
    (9_600, 0x09),
    (19_200, 0x07),
    (38_400, 0x05),
    (57_600, 0x04),
    (115_200, 0x02),
    (230_400, 0x01),
    (460_800, 0x00),
    (921_600, 0x0A),
    (2_000_000, 0x0C),
    (3_500_000, 0x0E),
    (4_000_000, 0x0D),
];

/// Rate of an item that is in every message.
const EVERY: u16 = 0xFFFF;
/// Rate of the temperature, Hz.
const TEMPERATURE_RATE: u16 = 1;
/// Largest rate of the orientation, Hz.
const RATE_MAX: u16 = 400;
/// Bytes of a sample with [`outputs`] and a temperature.
pub const SAMPLE_LEN: usize = super::SAMPLE_LEN_MIN + 5 + 7 + 7 + 7;

/// Bytes of [`outputs`].
const OUTPUTS_LEN: usize = 4 + 7 * 4 + 1;

/// Returns the message that selects the outputs of a [`Sample`](crate::imu::Sample): quaternion,
/// acceleration and rate of turn with `rate_hz`; packet counter, sample time and status with each
/// of them; temperature once a second. All in `f32` and ENU. `None` for rates other than 1 to 400.
///
/// The device takes the nearest rate that it has. At 400 Hz it needs 921600 baud, at 100 Hz 115200.
#[must_use]
pub fn outputs(rate_hz: u16) -> Option<[u8; OUTPUTS_LEN]> {
    if !(1..=RATE_MAX).contains(&rate_hz) {
        return None;
    }
    let rates = [
        (item::COUNTER, EVERY),
        (item::TIME, EVERY),
        (item::QUATERNION, rate_hz),
        (item::ACCELERATION, rate_hz),
        (item::RATE_OF_TURN, rate_hz),
        (item::TEMPERATURE, TEMPERATURE_RATE),
        (item::STATUS, EVERY),
    ];
    let mut message = [0; OUTPUTS_LEN];
    message[..4].copy_from_slice(&[0xFA, 0xFF, 0xC0, 4 * rates.len() as u8]);
    for (index, (identifier, rate)) in rates.into_iter().enumerate() {
        message[4 + 4 * index..][..2].copy_from_slice(&identifier.to_be_bytes());
        message[6 + 4 * index..][..2].copy_from_slice(&rate.to_be_bytes());
    }
    message[OUTPUTS_LEN - 1] = checksum(&message[..OUTPUTS_LEN - 1]);
    Some(message)
}

/// Returns the message SetBaudrate; `None` for a rate that the device does not have.
#[must_use]
pub fn set_baud(baud: u32) -> Option<[u8; 6]> {
    let code = BAUDS.iter().find(|row| row.0 == baud)?.1;
    let mut message = [0xFA, 0xFF, 0x18, 0x01, code, 0];
    message[AROUND] = checksum(&message[..AROUND]);
    Some(message)
}

/// The answer to a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// The device did it. It may have taken another rate than that of [`outputs`].
    Done,
    /// The device refused, with this code of the vendor.
    Refused(u8),
}

/// Finds the answer to one message in a stream of bytes.
#[derive(Debug, Clone)]
pub struct Answers {
    asked: u8,
    window: Window<{ 2 * MESSAGE_LEN_MAX }>,
}

impl Answers {
    /// Returns a decoder for the answer to `message`.
    #[must_use]
    pub fn to(message: &[u8]) -> Self {
        Self { asked: message.get(START.len()).copied().unwrap_or(0), window: Window::new() }
    }

    /// Takes the next byte. Returns the answer that it completes.
    pub fn push(&mut self, byte: u8) -> Option<Answer> {
        self.window.push(byte);
        (0..=MESSAGE_LEN_MAX - AROUND).find_map(|len| {
            let message = self.window.last(AROUND + len)?;
            let is_whole = message[..START.len()] == START && usize::from(message[3]) == len;
            if !is_whole || checksum(&message[..message.len() - 1]) != message[message.len() - 1] {
                return None;
            }
            let data = &message[4..4 + len];
            match message[2] {
                ERROR => Some(Answer::Refused(data.first().copied().unwrap_or(0))),
                id if id == self.asked.wrapping_add(1) => Some(Answer::Done),
                _ => None,
            }
        })
    }
}
