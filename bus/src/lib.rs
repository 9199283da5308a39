//! The wire, as the rest of motord sees it.
//!
//! A [`Bus`] takes frames and gives back what arrived, stamped with the time it arrived at. It never blocks, and after
//! it was opened it never allocates. Waiting is not its business: it tells what to wait for ([`Readiness`]), and the
//! owner waits for all its buses in one system call.
//!
//! - [`time`]: instants and durations, as values that are passed in.
//! - [`frame`]: the content of a classic CAN frame, and a controller's report on itself.
//! - [`arithmetic`]: how many bits a frame takes, and how much of a cycle a bus needs.
//! - [`candump`]: the logs of CAN traffic.
//!
//! The feature `linux`, on by default, adds all that makes system calls:
//!
//! - `socketcan`: the CAN interfaces of Linux.
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
mod readiness;
#[cfg(feature = "linux")]
pub mod socketcan;
pub mod time;
#[cfg(feature = "linux")]
mod wait;

pub use frame::{Arrival, Content, ErrorFrame, Frame, FrameId, Inbox, Unsupported};
pub use readiness::{MAX_BUSES, Readiness, Ready};
pub use time::{Duration, Instant};
#[cfg(feature = "linux")]
pub use wait::wait;

/// One bus: a CAN interface, a serial port, or a simulation of them.
///
/// Every method is called from the real-time thread: none allocates, blocks, or runs an unbounded loop.
pub trait Bus: Send {
    /// Hands `frames` over in this order. At most one system call. What was not accepted is dropped, never kept for
    /// later: a late torque is worse than none.
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent;

    /// Adds what has arrived by `now` to `inbox`, oldest first, until nothing is left or the inbox is full. At most
    /// one system call.
    fn receive(&mut self, now: Instant, inbox: &mut Inbox);

    /// What to wait for until [`receive`](Self::receive) has something.
    fn readiness(&self) -> Readiness<'_>;
}

/// What became of the frames given to [`Bus::send`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sent {
    /// How many of the frames were accepted, counted from the first.
    pub accepted: usize,
    /// Why the others were not. `None` exactly when all were accepted.
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
