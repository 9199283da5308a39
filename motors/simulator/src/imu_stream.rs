//! The bytes of a simulated IMU on a serial line, by the vendors' documents.

use crate::imu::ImuValues;
use core::f64::consts::PI;
use motord_bus::Duration;

/// HiPNUC: m/s² of one G of the firmware.
const G: f64 = 9.8;

/// The vendor of an IMU on a serial line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImuVendor {
    /// 0x91 frames.
    Hipnuc,
    /// MTData2 messages.
    Xsens,
}

/// Makes the bytes of successive samples.
#[derive(Debug, Clone)]
pub struct ImuStream {
    vendor: ImuVendor,
    number: u16,
}

impl ImuStream {
    /// Returns a device that was switched on.
    #[must_use]
    pub const fn new(vendor: ImuVendor) -> Self {
        Self { vendor, number: 0 }
    }

    /// Counts a sample, and returns its bytes. `time` is that since the device was switched on.
    #[must_use]
    pub fn frame(&mut self, values: &ImuValues, time: Duration) -> Vec<u8> {
        self.number = self.number.wrapping_add(1);
        match self.vendor {
            ImuVendor::Hipnuc => hipnuc(values, time),
            ImuVendor::Xsens => xsens(values, time, self.number),
        }
    }

    /// Counts a sample that is not sent.
    pub const fn skip(&mut self) {
        self.number = self.number.wrapping_add(1);
    }

    /// Returns the bytes with which a sample begins.
    #[must_use]
    pub const fn header(&self) -> [u8; 4] {
        match self.vendor {
            ImuVendor::Hipnuc => [0x5A, 0xA5, 76, 0],
            ImuVendor::Xsens => [0xFA, 0xFF, 0x36, 0x4B],
        }
    }
}

/// A 0x91 frame: user manual, "binary serial protocol".
fn hipnuc(values: &ImuValues, time: Duration) -> Vec<u8> {
    let floats = |bytes: &mut Vec<u8>, numbers: &[f64]| {
        numbers.iter().for_each(|number| bytes.extend((*number as f32).to_le_bytes()));
    };
    let mut payload = vec![0x91, 0, 0, values.temperature.round() as i8 as u8];
    floats(&mut payload, &[101_325.0]);
    payload.extend((time.as_millis() as u32).to_le_bytes());
    floats(&mut payload, &values.acceleration.map(|value| value / G));
    floats(&mut payload, &values.angular_velocity.map(|value| value * 180.0 / PI));
    floats(&mut payload, &[20.0, 0.0, -40.0]);
    floats(&mut payload, &euler(values.orientation));
    floats(&mut payload, &values.orientation);
    let [low, high] = (payload.len() as u16).to_le_bytes();
    let mut frame = vec![0x5A, 0xA5, low, high];
    let crc = crc16(frame.iter().chain(&payload));
    frame.extend(crc.to_le_bytes());
    frame.extend(payload);
    frame
}

/// An MTData2 message: "MT low level communication protocol".
fn xsens(values: &ImuValues, time: Duration, number: u16) -> Vec<u8> {
    let mut data = Vec::new();
    let mut item = |identifier: u16, value: &[u8]| {
        data.extend(identifier.to_be_bytes());
        data.push(value.len() as u8);
        data.extend(value);
    };
    let floats = |numbers: &[f64]| -> Vec<u8> {
        numbers.iter().flat_map(|number| (*number as f32).to_be_bytes()).collect()
    };
    item(0x1020, &number.to_be_bytes());
    item(0x1060, &((time.as_micros() / 100) as u32).to_be_bytes());
    item(0x2010, &floats(&values.orientation));
    item(0x4020, &floats(&values.acceleration));
    item(0x8020, &floats(&values.angular_velocity));
    item(0x0810, &floats(&[values.temperature]));
    // Self-test passed, filter valid.
    item(0xE020, &[0, 0, 0, 3]);
    let mut message = vec![0xFA, 0xFF, 0x36, data.len() as u8];
    message.extend(data);
    let sum = message[1..].iter().map(|byte| u32::from(*byte)).sum::<u32>();
    message.push((256 - sum % 256) as u8);
    message
}

/// Roll, pitch and yaw, °.
fn euler([w, x, y, z]: [f64; 4]) -> [f64; 3] {
    let roll = f64::atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y));
    let pitch = (2.0 * (w * y - z * x)).clamp(-1.0, 1.0).asin();
    let yaw = f64::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z));
    [roll, pitch, yaw].map(f64::to_degrees)
}

/// CRC-16 with the polynomial 0x1021 and the initial value 0, a byte at a time without a table.
fn crc16<'b>(bytes: impl Iterator<Item = &'b u8>) -> u16 {
    bytes.fold(0, |crc: u16, byte| {
        let mut crc = crc.swap_bytes() ^ u16::from(*byte);
        crc ^= (crc & 0xFF) >> 4;
        crc ^= crc << 12;
        crc ^ (crc & 0xFF) << 5
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The check value of CRC-16/XMODEM.
    #[test]
    fn checksum_is_that_of_the_catalogue() {
        assert_eq!(crc16(b"123456789".iter()), 0x31C3);
    }

    fn at_rest() -> ImuValues {
        ImuValues {
            orientation: [0.5; 4],
            angular_velocity: [PI / 2.0, 0.0, -PI],
            acceleration: [0.0, 0.0, G],
            temperature: 25.0,
        }
    }

    /// 0x3F800000 is 1 G, 0x42B40000 is 90 °/s, 0xC3340000 is -180 °/s, 0x3F000000 is 0.5.
    #[test]
    fn hipnuc_frame_has_documented_bytes() {
        let frame = ImuStream::new(ImuVendor::Hipnuc).frame(&at_rest(), Duration::from_secs(1));
        assert_eq!(frame.len(), 82);
        assert_eq!(frame[..4], [0x5A, 0xA5, 0x4C, 0]);
        assert_eq!(frame[6..10], [0x91, 0, 0, 0x19]);
        assert_eq!(frame[14..18], [0xE8, 0x03, 0, 0]);
        assert_eq!(frame[18..30], [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x80, 0x3F]);
        assert_eq!(frame[30..42], [0, 0, 0xB4, 0x42, 0, 0, 0, 0, 0, 0, 0x34, 0xC3]);
        assert_eq!(frame[66..], [[0, 0, 0, 0x3F]; 4].concat());
    }

    #[test]
    fn xsens_message_has_documented_bytes() {
        let message = ImuStream::new(ImuVendor::Xsens).frame(&at_rest(), Duration::from_secs(1));
        assert_eq!(message[..4], [0xFA, 0xFF, 0x36, 75]);
        assert_eq!(message[4..16], [0x10, 0x20, 2, 0, 1, 0x10, 0x60, 4, 0, 0, 0x27, 0x10]);
        assert_eq!(message[16..23], [0x20, 0x10, 16, 0x3F, 0, 0, 0]);
        assert_eq!(message.iter().skip(1).fold(0_u8, |sum, byte| sum.wrapping_add(*byte)), 0);
    }
}
