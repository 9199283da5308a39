//! Messages that select the outputs and their rate. Source: MT low level communication protocol,
//! MT0101P, chapters "GoToConfig", "SetOutputConfiguration" and "GoToMeasurement".
//!
//! Send [`GO_TO_CONFIG`], then [`outputs`], then [`GO_TO_MEASUREMENT`]. The device confirms each with the
//! message id plus one, and stores the outputs. On a serial port a device has no id.

use super::decoder::checksum;
use super::item;

/// Stops the measurements, and permits settings.
pub const GO_TO_CONFIG: [u8; 5] = [0xFA, 0xFF, 0x30, 0x00, 0xD1];
/// Starts the measurements.
pub const GO_TO_MEASUREMENT: [u8; 5] = [0xFA, 0xFF, 0x10, 0x00, 0xF1];

/// Rate of an item that is in every message.
const EVERY: u16 = 0xFFFF;
/// Rate of the temperature, Hz.
const TEMPERATURE_RATE: u16 = 1;
/// Largest rate of the orientation, Hz.
const RATE_MAX: u16 = 400;
/// Bytes of [`outputs`].
const OUTPUTS_LEN: usize = 4 + 7 * 4 + 1;

/// Returns the message that selects the outputs of a [`Sample`](crate::imu::Sample): quaternion,
/// acceleration and rate of turn with `rate_hz`; packet counter, sample time and status with each of
/// them; temperature once a second. All in `f32` and ENU. `None` for rates other than 1 to 400.
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
