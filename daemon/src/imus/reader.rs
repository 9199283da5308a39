//! A source of samples that a thread reads.

use motord_bus::Duration;

/// Longest wait of a turn, so that the thread sees that the daemon ends.
pub(super) const TURN: Duration = Duration::from_millis(50);

/// A source of samples with a dedicated thread, which takes turns until the daemon ends.
pub trait Reader: Send {
    /// Returns the name of its thread, without the prefix of the daemon.
    fn thread(&self) -> &'static str;

    /// Waits for samples, and passes those that have arrived. Returns after 50 ms at most, but for
    /// the time in which the kernel opens a device, and for the rest after a hostile stream.
    fn turn(&mut self);
}
