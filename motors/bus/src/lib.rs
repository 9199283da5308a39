//! Buses: CAN frames and their times, SocketCAN, and the arithmetic of bus load.
//!
//! A [`Bus`] sends frames and delivers arrivals with their times. It never blocks, and after it was opened it never
//! allocates. It does not wait either: it says when a read is worth while ([`Readiness`]), and its owner waits for all buses
//! in one system call.
//!
//! - [`time`]: instants and durations, as values that are passed in.
//! - [`frame`]: frames of CAN and CAN FD, and a controller's report on itself.
//! - [`arithmetic`]: how many bits a frame takes, and how much of a cycle a bus needs.
//! - [`candump`]: the logs of CAN traffic.
//! - [`serial`]: RS485 and RS232.
//!
//! The feature `linux`, on by default, adds all that makes system calls:
//!
//! - `socketcan`: the CAN interfaces of Linux. `serial::SerialBus`: its serial ports.
//! - `wait` and `clock`: sleeping until something arrives, and the time.

pub mod arithmetic;
pub mod candump;
#[cfg(feature = "linux")]
pub mod clock;
#[cfg(feature = "conformance")]
pub mod conformance;
pub mod frame;
#[allow(unsafe_code, reason = "system calls that no safe crate offers")]
#[cfg(feature = "linux")]
mod kernel;
mod learned;
#[cfg(feature = "linux")]
mod lock;
mod readiness;
pub mod serial;
#[cfg(feature = "linux")]
pub mod socketcan;
pub mod time;
mod virtual_clock;
#[cfg(feature = "linux")]
mod wait;

pub use frame::{Arrival, Content, ErrorFrame, Format, Frame, FrameId, Inbox, Unsupported};
pub use learned::{Backoff, Lateness, ReplyTime};
#[cfg(feature = "linux")]
pub use lock::{BusLock, Holder, LockError};
pub use readiness::{Clock, MAX_BUSES, Readiness, Ready};
pub use time::{Duration, Instant};
pub use virtual_clock::VirtualClock;
#[cfg(feature = "linux")]
pub use wait::{Monotonic, wait};

/// One bus: a CAN interface, a serial port, or a simulation of them.
///
/// Every method is called from the real-time thread: none allocates, blocks, or runs an unbounded loop.
pub trait Bus: Send {
    /// Sends `frames` in this order. At most one system call; a serial line takes one more after a request that was not
    /// answered. Frames that are not accepted are dropped, never kept for
    /// later: a late torque is worse than none.
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent;

    /// Adds the arrivals until `now` to `inbox`, oldest first, until none is left or the inbox is full. At most one
    /// system call.
    fn receive(&mut self, now: Instant, inbox: &mut Inbox);

    /// When the next [`receive`](Self::receive) has something.
    fn readiness(&self) -> Readiness<'_>;
}

/// The outcome of [`Bus::send`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sent {
    /// The number of frames that were accepted: the first ones.
    pub accepted: usize,
    /// Why the others were not accepted. `None` exactly when all were.
    pub refusal: Option<Refusal>,
}

impl Sent {
    /// All `count` frames were accepted.
    #[must_use]
    pub const fn all(count: usize) -> Self {
        Self { accepted: count, refusal: None }
    }
}

/// Why a bus did not take a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// The transmit queue is full (`ENOBUFS`, `EAGAIN`): nobody on the bus acknowledges, or it is overloaded.
    Full,
    /// The interface is down (`ENETDOWN`).
    Down,
    /// The interface is gone (`ENODEV`, `ENXIO`, `EIO` of an unplugged adapter). Only opening it again helps.
    Gone,
    /// Anything else, by its `errno`.
    Error(i32),
}
