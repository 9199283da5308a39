//! Serial lines, RS485 and RS232 (GIM document, tables 1 and 3).
//!
//! `SerialBus` is the line as a [`Bus`](crate::Bus). A frame that is sent bears the motor's id; the header of
//! [`framing`] is added here. An arrival bears the id of the motor whose request it answers.
//!
//! One request is in flight on a line. While it has still time for its reply, sending is refused with
//! [`Refusal::Full`](crate::Refusal::Full).
//!
//! - [`framing`]: the bytes of a frame, and finding frames in a stream of bytes.
//! - `line`: which bytes answer the open request.
//! - `port`: the device.

#[cfg(feature = "linux")]
mod bus;
pub mod framing;
#[cfg(feature = "linux")]
mod line;
#[cfg(feature = "linux")]
mod port;
#[cfg(feature = "linux")]
mod stream;

use crate::time::Duration;

#[cfg(feature = "linux")]
pub use bus::{SerialBus, SerialSender};
#[cfg(feature = "linux")]
pub use port::{OpenError, Port};
#[cfg(feature = "linux")]
pub use stream::ByteStream;

/// Whether the payload of a reply can answer that of a request: the command byte and the numbers that a reply repeats are the
/// same. A payload has no checksum, and this is what tells noise from a reply. Must be pure, and must not panic.
pub type Answers = fn(request: &[u8], reply: &[u8]) -> bool;

/// The ids of a motor on a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Address {
    /// The motor's own: the receiver of its requests.
    pub id: u8,
    /// The receiver that its replies name. `None` when it is not known: then any is taken.
    pub host_id: Option<u8>,
}

/// The line to open, and its motors.
#[derive(Debug, Clone)]
pub struct Settings {
    /// The device, `/dev/ttyUSB0`.
    pub device: String,
    /// Bit/s.
    pub baud: u32,
    /// The motors. The replies of one that is not listed may name any receiver.
    pub addresses: Vec<Address>,
    /// A request that is older than this no longer keeps the line busy: the next one may be sent.
    pub reply_timeout: Duration,
    /// Which reply answers which request.
    pub answers: Answers,
}
