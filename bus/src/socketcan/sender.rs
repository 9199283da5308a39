//! Sending and nothing else, for whoever stops the motors of a daemon that has died.

use std::os::fd::AsFd;

use nix::net::if_::if_nametoindex;
use socketcan::{CanSocket, Socket, SocketOptions};

use super::{InterfaceName, OpenError, bind, failed, limit_queue, raw_socket, send, wire};
use crate::frame::{Frame, Inbox};
use crate::kernel::Batch;
use crate::time::Instant;
use crate::{Bus, Readiness, Sent};

/// Sends on the interface of a name, whichever that is: one that is missing, or was unplugged and plugged in again, refuses
/// with [`Refusal::Gone`](crate::Refusal::Gone) until it is [found](Self::find).
///
/// It takes the interface as it is, and leaves alone what a daemon has set up. One that is down refuses with
/// [`Refusal::Down`](crate::Refusal::Down) until it is up.
pub struct Sender {
    interface: InterfaceName,
    socket: CanSocket,
    outgoing: Batch,
}

impl Sender {
    /// For up to `frames` at a time. The interface need not be there. Allocates.
    ///
    /// # Errors
    ///
    /// [`OpenError::System`]: the kernel has no CAN, or there are no descriptors left.
    pub fn new(interface: InterfaceName, frames: u32) -> Result<Self, OpenError> {
        let socket = raw_socket(interface)?;
        let nothing = socket.set_filters::<(u32, u32)>(&[]);
        nothing.and_then(|()| limit_queue(&socket, frames)).map_err(|error| failed(interface, &error))?;
        Ok(Self { interface, socket, outgoing: Batch::new(Inbox::CAPACITY, wire::CLASSIC_BYTES) })
    }

    /// Finds the interface that has the name now. Does not allocate; five system calls. Not for the real-time thread of a
    /// robot that moves: it waits while any other process, or the kernel itself when adapters come and go, configures
    /// interfaces, however long that takes. With `CAP_NET_ADMIN` it also waits while the kernel looks for a
    /// driver of that name (`modprobe`).
    ///
    /// # Errors
    ///
    /// [`OpenError::Missing`], [`OpenError::NotCan`] or [`OpenError::System`].
    pub fn find(&mut self) -> Result<(), OpenError> {
        let index =
            if_nametoindex(self.interface.as_str()).map_err(|_| OpenError::Missing(self.interface))?;
        bind(&self.socket, self.interface, index)?;
        // What happened to the interface before is told once more by the next call otherwise.
        self.socket.as_raw_socket().take_error().map_err(|error| failed(self.interface, &error))?;
        Ok(())
    }
}

impl Bus for Sender {
    /// One `sendmmsg`.
    fn send(&mut self, _now: Instant, frames: &[Frame]) -> Sent {
        send(&mut self.outgoing, self.socket.as_fd(), frames)
    }

    /// Nothing ever comes.
    fn receive(&mut self, _now: Instant, _inbox: &mut Inbox) {}

    fn readiness(&self) -> Readiness<'_> {
        Readiness::Never
    }
}
