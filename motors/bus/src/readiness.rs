//! When a bus is worth a [`receive`](crate::Bus::receive), and the clock that waits for it.

use std::os::fd::BorrowedFd;

use crate::time::{Duration, Instant};

/// When the next [`Bus::receive`](crate::Bus::receive) is worth while. Borrows the bus, so that its descriptor stays
/// open for as long as somebody waits for it.
#[derive(Debug, Clone, Copy)]
pub enum Readiness<'a> {
    /// When this file descriptor becomes readable, or has an error.
    Readable(BorrowedFd<'a>),
    /// When the clock reaches this instant: simulated buses know when the next frame ends.
    At(Instant),
    /// Not before something is sent: nothing is under way.
    Never,
}

/// The most buses that one wait watches. Those beyond it are ignored.
pub const MAX_BUSES: usize = 64;

/// Which buses are worth a [`receive`](crate::Bus::receive), by their index in the slice of readinesses that was waited
/// for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Ready(u64);

impl Ready {
    /// From one flag per bus, in the order of the buses. Flags beyond [`MAX_BUSES`] are ignored.
    #[must_use]
    #[inline]
    pub fn of(buses: impl IntoIterator<Item = bool>) -> Self {
        let ready = buses.into_iter().take(MAX_BUSES).enumerate();
        Self(ready.fold(0, |bits, (index, ready)| bits | u64::from(ready) << index))
    }

    /// Whether the bus at `index` is ready.
    #[must_use]
    pub const fn contains(self, index: usize) -> bool {
        index < MAX_BUSES && self.0 & (1 << index) != 0
    }

    /// How many buses are ready.
    #[must_use]
    pub const fn count(self) -> usize {
        self.0.count_ones() as usize
    }

    /// Whether any bus is ready.
    #[must_use]
    pub const fn any(self) -> bool {
        self.0 != 0
    }
}

/// Time, and waiting for it.
pub trait Clock {
    /// The present time.
    fn now(&self) -> Instant;

    /// The present time, and the total time that the computer was suspended since it was started, never overestimated. On
    /// most machines this takes no system call (vDSO).
    fn now_and_suspended(&self) -> (Instant, Duration);

    /// Returns at `instant`, or at once when it has passed. A signal may end the sleep earlier. At most one system call.
    fn sleep_until(&mut self, instant: Instant);

    /// Waits until a bus has something, at most until `until`, and returns the buses that have. A signal may end the wait earlier,
    /// with no bus ready. At most one system call.
    fn wait(&mut self, readiness: &[Readiness<'_>], until: Instant) -> Ready;
}
