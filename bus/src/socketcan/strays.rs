//! Frames that belong to nobody on the bus.

use std::os::fd::AsFd;

use socketcan::{CanSocket, SocketOptions};

use super::{EXACT, Link, OpenError, open_socket, wire};
use crate::frame::{FrameId, Inbox};
use crate::kernel::{Batch, FRAME_BYTES};

/// Counts frames with other ids than the expected ones, on a socket of its own, so that a flood of them costs the
/// real-time thread nothing. For housekeeping: its thread reads at its leisure, the kernel counts what its buffer
/// cannot hold.
pub struct Strays {
    socket: CanSocket,
    batch: Batch,
    read: u64,
    /// `SO_RXQ_OVFL`, unwrapped.
    dropped: u64,
}

impl Strays {
    /// The most calls of [`count`](Self::count) spend on reading: more than a receive buffer of the usual 208 KiB holds.
    const BATCHES: usize = 8;

    /// Counts on the interface of `link` every frame, of any kind but error reports, whose id is not among `expected`: both
    /// the ids motors answer with and those they are commanded by.
    ///
    /// # Errors
    ///
    /// [`OpenError::NotCan`] when the interface is gone, or [`OpenError::System`].
    pub fn open(link: &Link, expected: &[FrameId]) -> Result<Self, OpenError> {
        let socket = open_socket(link.interface, link.index, |socket| {
            let others: Vec<(u32, u32)> =
                expected.iter().map(|id| (u32::from(id.raw()) | libc::CAN_INV_FILTER, EXACT)).collect();
            if !others.is_empty() {
                socket.set_filters(&others)?;
            }
            socket.set_join_filters(true)?;
            socket.set_socket_option_int(libc::SOL_CAN_RAW, libc::CAN_RAW_FD_FRAMES, 1)?;
            socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_RXQ_OVFL, 1)
        })?;
        Ok(Self { socket, batch: Batch::new(Inbox::CAPACITY, FRAME_BYTES), read: 0, dropped: 0 })
    }

    /// How many there were since opening. Does not block or allocate; a few system calls. What the kernel had to drop is
    /// counted with the next frame that comes.
    pub fn count(&mut self) -> u64 {
        for _ in 0..Self::BATCHES {
            let count = self.batch.receive(self.socket.as_fd(), self.batch.capacity()).unwrap_or(0);
            (0..count).for_each(|index| self.read_one(index));
            if count < self.batch.capacity() {
                break;
            }
        }
        self.read + self.dropped
    }

    fn read_one(&mut self, index: usize) {
        self.read += 1;
        if let Some(dropped) = wire::ancillary(self.batch.message(index).control()).dropped {
            self.dropped += u64::from(dropped.wrapping_sub(self.dropped as u32));
        }
    }
}
