//! Commands that set rate, identifier and bit rate.
//!
//! On a serial line, commands are lines of text. Send [`PAUSE`] first: the device ignores commands
//! among its own data. Firmware of the command manual answers `OK`. Sources: SDK,
//! `device_setup.ini` and `cmd_write.c`; user manual, AT commands.
//!
//! On a CAN bus, they are CANopen's NMT commands and expedited SDO downloads. The device stores
//! them. Source: user manual, CANopen commands. A new rate acts at once, a new node or bit rate
//! after a power cycle.

use super::can::{NODE_MAX, Tpdo};
use crate::imu::request::CanRequest;

/// Stops the data on a serial line until [`RESUME`].
pub const PAUSE: &str = "LOG DISABLE\r\n";
/// Starts the data on a serial line.
pub const RESUME: &str = "LOG ENABLE\r\n";
/// Stores the settings. Without it, they last until a power cycle.
pub const SAVE: &str = "SAVECONFIG\r\n";
/// Restarts the device, as a new baud rate needs.
pub const RESTART: &str = "REBOOT\r\n";

/// Largest node that the device accepts.
const NODE_SETTABLE_MAX: u8 = 64;
/// Id of NMT commands.
const NMT: u16 = 0x000;
/// Id of SDO requests, without the node.
const SDO: u16 = 0x600;
/// Id of the answers to SDO requests, without the node. Source: SDK, `hipnuc_can_update.c`.
const SDO_ANSWER: u16 = 0x580;
/// First byte of the answer to a download, and of an answer that refuses.
const DOWNLOADED: u8 = 0x60;
const ABORTED: u8 = 0x80;
/// First byte of the request for a value (CANopen, CiA 301).
const UPLOAD: u8 = 0x40;

/// The rates of 0x91 frames, Hz, with the line for firmware from the command manual on and the line
/// for firmware of the user manuals. 250, 500 and 1000 Hz need the former, and 400 Hz the latter.
const RATES: [(u16, Option<&str>, Option<&str>); 12] = [
    (1, Some("LOG HI91 ONTIME 1\r\n"), Some("AT+ODR=1\r\n")),
    (2, Some("LOG HI91 ONTIME 0.5\r\n"), Some("AT+ODR=2\r\n")),
    (5, Some("LOG HI91 ONTIME 0.2\r\n"), Some("AT+ODR=5\r\n")),
    (10, Some("LOG HI91 ONTIME 0.1\r\n"), Some("AT+ODR=10\r\n")),
    (20, Some("LOG HI91 ONTIME 0.05\r\n"), Some("AT+ODR=20\r\n")),
    (50, Some("LOG HI91 ONTIME 0.02\r\n"), Some("AT+ODR=50\r\n")),
    (100, Some("LOG HI91 ONTIME 0.01\r\n"), Some("AT+ODR=100\r\n")),
    (200, Some("LOG HI91 ONTIME 0.005\r\n"), Some("AT+ODR=200\r\n")),
    (250, Some("LOG HI91 ONTIME 0.004\r\n"), None),
    (400, None, Some("AT+ODR=400\r\n")),
    (500, Some("LOG HI91 ONTIME 0.002\r\n"), None),
    (1000, Some("LOG HI91 ONTIME 0.001\r\n"), None),
];

/// Returns the line that sets the rate of 0x91 frames; `None` for a rate that the device does not
/// have. 82 bytes a frame need 115200 baud up to 100 Hz, 921600 baud above.
#[must_use]
pub fn serial_rate(rate_hz: u16) -> Option<&'static str> {
    RATES.iter().find(|row| row.0 == rate_hz)?.1
}

/// Like [`serial_rate`], for firmware of the user manuals (before `LOG`). Needs a restart.
#[must_use]
pub fn serial_rate_at(rate_hz: u16) -> Option<&'static str> {
    RATES.iter().find(|row| row.0 == rate_hz)?.2
}

/// Returns the rates of [`serial_rate`], rising.
pub fn serial_rates() -> impl Iterator<Item = u16> {
    RATES.iter().filter(|row| row.1.is_some()).map(|row| row.0)
}

/// Returns the line that sets the baud rate; `None` for others than 115200, 460800 and 921600. Then
/// send [`SAVE`] and [`RESTART`].
#[must_use]
pub const fn serial_baud(baud: u32) -> Option<&'static str> {
    match baud {
        115_200 => Some("SERIALCONFIG 115200\r\n"),
        460_800 => Some("SERIALCONFIG 460800\r\n"),
        921_600 => Some("SERIALCONFIG 921600\r\n"),
        _ => None,
    }
}

/// Returns the NMT command that starts the TPDOs of `node`.
#[must_use]
pub fn start(node: u8) -> CanRequest {
    CanRequest::new(NMT, [0x01, node & NODE_MAX])
}

/// Returns the NMT command that stops the TPDOs of `node`.
#[must_use]
pub fn stop(node: u8) -> CanRequest {
    CanRequest::new(NMT, [0x02, node & NODE_MAX])
}

/// Returns the request that sets the period of a TPDO, ms: 5 to 100, or 0 to switch it off. `None`
/// for other periods.
#[must_use]
pub fn period(node: u8, tpdo: Tpdo, period_ms: u16) -> Option<CanRequest> {
    let [low, high] = period_ms.to_le_bytes();
    let payload = [0x2B, tpdo.index(), 0x18, 0x05, low, high, 0, 0];
    matches!(period_ms, 0 | 5..=100).then(|| CanRequest::new(sdo(node), payload))
}

/// Returns the request that sets the node; `None` for others than 1 to 64.
#[must_use]
pub fn set_node(node: u8, new: u8) -> Option<CanRequest> {
    let is_node = (1..=NODE_SETTABLE_MAX).contains(&new);
    is_node.then(|| CanRequest::new(sdo(node), [0x23, 0x01, 0x21, 0, new, 0, 0, 0]))
}

/// Returns the request that sets the bit rate, bit/s; `None` for others than 125, 250, 500 and 1000
/// kbit/s.
#[must_use]
pub fn set_bit_rate(node: u8, bit_rate: u32) -> Option<CanRequest> {
    let is_rate = matches!(bit_rate, 125_000 | 250_000 | 500_000 | 1_000_000);
    let [a, b, c, d] = bit_rate.to_le_bytes();
    is_rate.then(|| CanRequest::new(sdo(node), [0x23, 0x00, 0x21, 0, a, b, c, d]))
}

/// Returns the request that reads what `request` writes. Source: CANopen, CiA 301; the user manual
/// has no example of it.
#[must_use]
pub fn read_back(request: &CanRequest) -> CanRequest {
    let mut bytes = [UPLOAD, 0, 0, 0, 0, 0, 0, 0];
    for (byte, written) in bytes[1..4].iter_mut().zip(request.payload().iter().skip(1)) {
        *byte = *written;
    }
    CanRequest::new(request.id(), bytes)
}

/// An answer to an SDO request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// The device took the value.
    Written,
    /// The value that the device has.
    Value(u32),
    /// The device refused, with this code of CANopen.
    Refused(u32),
}

/// Returns the answer to `request` in a frame; `None` for any other frame.
#[must_use]
pub fn answer(request: &CanRequest, id: u16, payload: &[u8]) -> Option<Answer> {
    let [first, at @ .., a, b, c, d]: [u8; 8] = payload.try_into().ok()?;
    let [_, asked @ .., _, _, _, _]: [u8; 8] = request.payload().try_into().ok()?;
    if id != request.id() - SDO + SDO_ANSWER || at != asked {
        return None;
    }
    let value = u32::from_le_bytes([a, b, c, d]);
    // Bits 2 and 3 of the answer to an upload are the number of bytes without a value.
    let unused = u32::from(first >> 2 & 3) * 8;
    match first {
        DOWNLOADED => Some(Answer::Written),
        ABORTED => Some(Answer::Refused(value)),
        0x43 | 0x47 | 0x4B | 0x4F => Some(Answer::Value(value & u32::MAX >> unused)),
        _ => None,
    }
}

const fn sdo(node: u8) -> u16 {
    SDO | (node & NODE_MAX) as u16
}
