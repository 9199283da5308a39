//! Buses: CAN frames and their times, SocketCAN, and the arithmetic of bus load.
//!
//! A [`Bus`] sends frames and delivers arrivals with their times. It never blocks, and after it was
//! opened it never allocates. It does not wait: it reports when a read is useful ([`Readiness`]),
//! and its owner waits for all buses in one system call.
//!
//! - [`time`]: instants and durations, as values.
//! - [`frame`]: frames of CAN and CAN FD, and a controller's reports on itself.
//! - [`arithmetic`]: the bits of a frame, and the share of a cycle that a bus needs.
//! - [`candump`]: the logs of CAN traffic.
//! - [`serial`]: RS485 and RS232.
//! - [`transport`]: the kinds of buses, as they are configured, and all that differs between them.
//!
//! The feature `linux`, on by default, adds everything that makes system calls:
//!
//! - `socketcan`: the CAN interfaces of Linux. `serial::SerialBus`: its serial ports.
//! - `wait` and `clock`: sleeping until something arrives, and the time.

#[cfg(feature = "linux")]
mod adapter;
pub mod arithmetic;
pub mod candump;
#[cfg(feature = "linux")]
pub mod clock;
#[cfg(feature = "conformance")]
pub mod conformance;
mod filter;
pub mod frame;
#[cfg(feature = "linux")]
mod holder;
#[cfg(feature = "linux")]
mod identity;
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
pub mod transport;
mod virtual_clock;
#[cfg(feature = "linux")]
mod wait;

#[cfg(feature = "linux")]
pub use adapter::{Adapter, Difference};
pub use filter::{IdFilter, IdSet};
pub use frame::{Arrival, Content, ErrorFrame, Format, Frame, FrameId, Inbox, Unsupported};
#[cfg(feature = "linux")]
pub use holder::Holder;
#[cfg(feature = "linux")]
pub use identity::Identity;
pub use learned::{Backoff, Lateness, ReplyTime};
#[cfg(feature = "linux")]
pub use lock::{BusLock, LockError};
pub use readiness::{Clock, MAX_BUSES, Readiness, Ready};
pub use time::{Duration, Instant};
pub use virtual_clock::VirtualClock;
#[cfg(feature = "linux")]
pub use wait::{Monotonic, wait};

/// One bus: a CAN interface, a serial port, or a simulation of them.
///
/// The real-time thread calls every method: none allocates, blocks, or runs an unbounded loop.
pub trait Bus: Send {
    /// Sends `frames` in this order. At most one system call; a serial line makes a second one
    /// after a request without a reply. Frames that are not accepted are dropped, never kept for
    /// later: a late torque is worse than none.
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent;

    /// Adds the arrivals until `now` to `inbox`, oldest first, until none is left or the inbox is
    /// full. At most one system call.
    fn receive(&mut self, now: Instant, inbox: &mut Inbox);

    /// Discards the frames that were accepted and wait for the wire, if that needs no system call.
    /// Returns whether none waits. False for a bus of the kernel: another thread empties that one,
    /// and opens it again.
    fn discard_queue(&mut self) -> bool {
        false
    }

    /// Returns the event at which the next [`receive`](Self::receive) returns something.
    fn readiness(&self) -> Readiness<'_>;
}

/// The outcome of [`Bus::send`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sent {
    /// Number of frames that were accepted: the first ones.
    pub accepted: usize,
    /// Reason for which the others were not accepted. `None` exactly when all were.
    pub refusal: Option<Refusal>,
}

impl Sent {
    /// Returns the outcome in which all `count` frames were accepted.
    #[must_use]
    pub const fn all(count: usize) -> Self {
        Self { accepted: count, refusal: None }
    }
}

/// Reason for which a bus did not accept a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// The transmit queue is full (`ENOBUFS`, `EAGAIN`): no node on the bus acknowledges, or the
    /// bus is overloaded.
    Full,
    /// The interface is down (`ENETDOWN`).
    Down,
    /// The interface is gone (`ENODEV`, `ENXIO`, `EIO` of an unplugged adapter). Open it again to
    /// recover.
    Gone,
    /// Any other error, by its `errno`.
    Error(i32),
}
