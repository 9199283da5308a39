//! Serial lines, RS485 and RS232 (GIM document, tables 1 and 3).
//!
//! `SerialBus` is the line as a [`Bus`](crate::Bus). A frame to send has the motor's id; this
//! module adds the header of [`framing`]. An arrival has the id of the motor whose request it
//! answers.
//!
//! One request is in flight on a line. Until its reply has arrived or is overdue, sending is
//! refused with [`Refusal::Full`](crate::Refusal::Full).
//!
//! - [`framing`]: the bytes of a frame, and finding frames in a stream of bytes.
//! - `line`: matching of bytes to the open request.
//! - `port`: the device.
//! - `unit`: the rules of systemd for devices.

#[cfg(feature = "linux")]
mod bus;
pub mod framing;
#[cfg(feature = "linux")]
mod line;
#[cfg(feature = "linux")]
mod port;
#[cfg(feature = "linux")]
mod unit;

#[cfg(feature = "linux")]
pub use bus::{SerialBus, SerialSender};
#[cfg(feature = "linux")]
pub use line::ByteStream;
#[cfg(feature = "linux")]
pub use port::{OpenError, Port};

use crate::time::Duration;

/// Returns `true` when the payload of a reply can answer that of a request: the command byte and
/// the repeated numbers are equal. A payload has no checksum, and this comparison distinguishes a
/// reply from noise. Must be pure, and must not panic.
pub type Answers = fn(request: &[u8], reply: &[u8]) -> bool;

/// The ids of a motor on a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Address {
    /// The motor's id: the receiver of its requests.
    pub id: u8,
    /// The receiver that its replies name. `None` when it is not known: any receiver is accepted.
    pub host_id: Option<u8>,
}

/// The line to open, and its motors.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Path of the device, such as `/dev/ttyUSB0`.
    pub device: String,
    /// Bit rate, bit/s.
    pub baud: u32,
    /// The motors. The replies of a motor that is not listed may name any receiver.
    pub addresses: Vec<Address>,
    /// A request that is older than this no longer keeps the line busy: the next one may be sent.
    pub reply_timeout: Duration,
    /// Decides whether a reply answers a request.
    pub answers: Answers,
}
