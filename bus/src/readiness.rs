//! When a bus is worth a [`receive`](crate::Bus::receive).

use std::os::fd::RawFd;

use crate::time::Instant;

/// What makes the next [`Bus::receive`] worth while.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Readiness {
    /// This file descriptor becomes readable.
    Readable(RawFd),
    /// The clock reaches this instant (simulated buses know when the next frame ends).
    At(Instant),
    /// Nothing is under way.
    Never,
}

/// The most buses that one wait watches. Those beyond it are ignored.
pub const MAX_BUSES: usize = 64;

/// Which buses are worth a [`receive`](crate::Bus::receive), by their index in the slice of
/// readinesses that was waited for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Ready(u64);

impl Ready {
    /// From what each bus is, in their order; what is beyond [`MAX_BUSES`] is ignored.
    #[must_use]
    pub fn of(buses: impl IntoIterator<Item = bool>) -> Self {
        let ready = buses.into_iter().take(MAX_BUSES).enumerate();
        Self(ready.fold(0, |bits, (index, ready)| bits | u64::from(ready) << index))
    }

    /// Whether the bus at `index` is.
    #[must_use]
    pub const fn contains(self, index: usize) -> bool {
        index < MAX_BUSES && self.0 & (1 << index) != 0
    }

    /// Whether any bus is.
    #[must_use]
    pub const fn any(self) -> bool {
        self.0 != 0
    }
}
