//! The byte stream below a line.

use nix::errno::Errno;

use crate::Readiness;

/// The bytes of a line, in both directions. [`SerialBus::open`](super::SerialBus::open) uses those
/// of a serial port.
pub trait ByteStream: Send {
    /// Writes `bytes`, and returns how many were accepted. Never blocks; at most one system call.
    ///
    /// # Errors
    ///
    /// The kernel's: `EAGAIN` when none was accepted.
    fn write(&self, bytes: &[u8]) -> Result<usize, Errno>;

    /// Reads bytes that have arrived, and returns their number; 0 when the other end is closed.
    /// Never blocks; at most one system call.
    ///
    /// # Errors
    ///
    /// The kernel's: `EAGAIN` when nothing has arrived.
    fn read(&self, buffer: &mut [u8]) -> Result<usize, Errno>;

    /// Returns the number of bytes that have not left. Never blocks; at most one system call.
    ///
    /// # Errors
    ///
    /// The kernel's.
    fn unsent(&self) -> Result<usize, Errno>;

    /// Returns the event at which the next [`read`](Self::read) returns something.
    fn readiness(&self) -> Readiness<'_>;
}
