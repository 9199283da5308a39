//! The carrier of a line's bytes.

use nix::errno::Errno;

use crate::Readiness;

/// The bytes of a line, in both directions. [`SerialBus::open`](super::SerialBus::open) takes those of a serial port.
pub trait ByteStream: Send {
    /// Writes `bytes`, and returns how many were taken. Never blocks; at most one system call.
    ///
    /// # Errors
    ///
    /// The kernel's: `EAGAIN` when none was taken.
    fn write(&self, bytes: &[u8]) -> Result<usize, Errno>;

    /// Reads bytes that have arrived, and returns how many; 0 when the other end is gone. Never blocks; at most one system call.
    ///
    /// # Errors
    ///
    /// The kernel's: `EAGAIN` when nothing has arrived.
    fn read(&self, buffer: &mut [u8]) -> Result<usize, Errno>;

    /// How many bytes have not left. Never blocks; at most one system call.
    ///
    /// # Errors
    ///
    /// The kernel's.
    fn unsent(&self) -> Result<usize, Errno>;

    /// When the next [`read`](Self::read) has something.
    fn readiness(&self) -> Readiness<'_>;
}
