//! A socket that only sends, for the stop of motors whose daemon has died.

use std::os::fd::AsFd;

use nix::net::if_::if_nametoindex;
use socketcan::{CanSocket, Socket, SocketOptions};

use super::{InterfaceName, OpenError, bind, failed, limit_queue, outgoing, raw_socket, send};
use crate::frame::{Frame, Inbox};
use crate::kernel::Batch;
use crate::time::Instant;
use crate::{Bus, Readiness, Refusal, Sent};

/// Sends on the interface with a given name. When the interface is missing, or was unplugged and
/// plugged in again, sending is refused with [`Refusal::Gone`] until the
/// interface is [found](Self::find).
///
/// The sender changes no settings of the interface. While the interface is down, sending is refused
/// with [`Refusal::Down`].
pub struct Sender {
    interface: InterfaceName,
    socket: CanSocket,
    outgoing: Batch,
}

impl Sender {
    /// Returns a sender of up to `frames` at a time. The interface may be missing. Allocates.
    ///
    /// # Errors
    ///
    /// [`OpenError::System`]: the kernel has no CAN, or no descriptors are left.
    pub fn new(interface: InterfaceName, frames: u32) -> Result<Self, OpenError> {
        let socket = raw_socket(interface)?;
        let nothing = socket.set_filters::<(u32, u32)>(&[]);
        nothing.and_then(|()| limit_queue(&socket, frames)).map_err(|error| failed(interface, &error))?;
        Ok(Self { interface, socket, outgoing: outgoing() })
    }

    /// Finds the interface that has the name now. Does not allocate; five system calls. Not for the
    /// real-time thread of a moving robot. It blocks, without a bound, while another process
    /// configures interfaces, or while the kernel does after an adapter was plugged in or out. With
    /// `CAP_NET_ADMIN` it also blocks while the kernel searches for a driver of that name
    /// (`modprobe`).
    ///
    /// # Errors
    ///
    /// [`OpenError::Missing`], [`OpenError::NotCan`] or [`OpenError::System`].
    pub fn find(&mut self) -> Result<(), OpenError> {
        let index =
            if_nametoindex(self.interface.as_str()).map_err(|_| OpenError::Missing(self.interface))?;
        bind(&self.socket, self.interface, index)?;
        // Otherwise the next call would report an error of the earlier interface.
        self.socket.as_raw_socket().take_error().map_err(|error| failed(self.interface, &error))?;
        Ok(())
    }
}

impl Bus for Sender {
    /// One `sendmmsg`. A second one after the interface was down: the kernel reports that once,
    /// even if it has been up again for hours.
    fn send(&mut self, _now: Instant, frames: &[Frame]) -> Sent {
        let sent = send(&mut self.outgoing, self.socket.as_fd(), frames);
        match sent.refusal {
            Some(Refusal::Down) if sent.accepted == 0 => {
                send(&mut self.outgoing, self.socket.as_fd(), frames)
            }
            _ => sent,
        }
    }

    /// Nothing ever arrives.
    fn receive(&mut self, _now: Instant, _inbox: &mut Inbox) {}

    fn readiness(&self) -> Readiness<'_> {
        Readiness::Never
    }
}
