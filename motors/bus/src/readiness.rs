//! Readiness of a bus for a [`receive`](crate::Bus::receive), and the clock that waits for it.

use std::os::fd::BorrowedFd;

use crate::time::{Duration, Instant};

/// Event at which the next [`Bus::receive`](crate::Bus::receive) is useful. Borrows the bus, so
/// that its descriptor stays open while a caller waits for it.
#[derive(Debug, Clone, Copy)]
pub enum Readiness<'a> {
    /// This file descriptor becomes readable, or has an error.
    Readable(BorrowedFd<'a>),
    /// The clock reaches this instant. Simulated buses know when the next frame ends.
    At(Instant),
    /// None before something is sent: nothing is under way.
    Never,
}

/// Most buses that one wait watches. Further buses are ignored.
pub const MAX_BUSES: usize = 64;

/// Buses that are ready for a [`receive`](crate::Bus::receive), by their index in the slice that
/// was waited for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Ready(u64);

impl Ready {
    /// Returns the set for one flag per bus, in the order of the buses. Flags beyond [`MAX_BUSES`]
    /// are ignored.
    #[must_use]
    #[inline]
    pub fn of(buses: impl IntoIterator<Item = bool>) -> Self {
        let ready = buses.into_iter().take(MAX_BUSES).enumerate();
        Self(ready.fold(0, |bits, (index, ready)| bits | u64::from(ready) << index))
    }

    /// Returns `true` when the bus at `index` is ready.
    #[must_use]
    pub const fn contains(self, index: usize) -> bool {
        index < MAX_BUSES && self.0 & (1 << index) != 0
    }

    /// Returns the number of buses that are ready.
    #[must_use]
    pub const fn count(self) -> usize {
        self.0.count_ones() as usize
    }

    /// Returns `true` when any bus is ready.
    #[must_use]
    pub const fn any(self) -> bool {
        self.0 != 0
    }
}

/// Time, and waiting for it.
pub trait Clock {
    /// Returns the present time.
    fn now(&self) -> Instant;

    /// Returns the present time, and the total time that the computer was suspended since it was
    /// started, never overestimated. On most machines this takes no system call (vDSO).
    fn now_and_suspended(&self) -> (Instant, Duration);

    /// Returns at `instant`, or immediately when it has passed. A signal may end the sleep earlier.
    /// At most one system call.
    fn sleep_until(&mut self, instant: Instant);

    /// Waits until a bus is ready, at most until `until`, and returns the buses that are ready. A
    /// signal may end the wait earlier, with no bus ready. At most one system call.
    fn wait(&mut self, readiness: &[Readiness<'_>], until: Instant) -> Ready;
}
