//! CAN interfaces of Linux (`PF_CAN`, raw protocol; kernel documentation, `networking/can.rst`).
//!
//! [`SocketCanBus::open`] configures and allocates. Afterwards, sending is one `sendmmsg` and
//! receiving one `recvmmsg`.
//!
//! Choices:
//! - *Filters*: one exact filter for every expected id, which the kernel finds in a table. Other
//!   frames cost the real-time thread nothing; [`UnexpectedIds`] counts them on another socket.
//! - *Error reports*: transmit timeout, lost arbitration, controller, no acknowledge, bus-off,
//!   restarted. Protocol and bus errors are not received: the state of the controller sums them up.
//! - *Transmit queue*: two cycles of commands, in the send buffer and, where permitted, in the
//!   interface's queue. Frames that a stalled bus cannot take are refused immediately and never
//!   sent later.
//! - *Receive stamps*: software stamps of the kernel, taken before any scheduling, converted to
//!   `CLOCK_MONOTONIC`. Hardware stamps are not used. They are readings of the controller's own
//!   counter, which CAN drivers do not offer as a clock, so its drift would be unknown
//!   (`docs/adr/0013`).
//! - *Loopback* stays on, so that `candump` shows the frames of motord. The bus does not receive
//!   its own frames.

mod announcements;
mod coalescing;
mod link;
mod name;
mod queue;
mod sender;
mod unexpected;
mod wire;

use std::io;
use std::os::fd::{AsFd, BorrowedFd};

use nix::errno::Errno;
use nix::sys::socket::{AddressFamily, SockFlag, SockProtocol, SockType, socket};
use socketcan::{CanAddr, CanSocket, Socket, SocketOptions};

use crate::clock::{self, RealtimeOffset};
use crate::filter::IdFilter;
use crate::frame::{ErrorFrame, Frame, Inbox};
use crate::kernel::{Batch, CLASSIC_BYTES, FRAME_BYTES, errno};
use crate::time::Instant;
use crate::{Bus, Readiness, Refusal, Sent};

pub use announcements::{Announcement, Announcements};
pub use coalescing::Coalescing;
pub use link::{Link, LinkNote, OpenError, RESTART_MS, Remedy, Step};
pub use name::{InterfaceName, InvalidName};
pub use sender::Sender;
pub use unexpected::{FdReplies, UnexpectedIds};

/// The interface to open, and its frames.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// The interface.
    pub interface: InterfaceName,
    /// The index that it must have; `None`: any. An interface of another index is left as it is,
    /// and counts as missing.
    pub index: Option<u32>,
    /// Bit rate in bit/s.
    pub bitrate: u32,
    /// Ids of the motors' replies, one per motor. The bus receives no other data frame.
    pub host_ids: Vec<IdFilter>,
    /// Frames that are sent in a cycle, without those to motors.
    pub requests: u32,
}

impl Settings {
    /// Returns the settings of a bus that receives no data frame yet, and sends none in a cycle.
    #[must_use]
    pub const fn new(interface: InterfaceName, bitrate: u32) -> Self {
        Self { interface, index: None, bitrate, host_ids: Vec::new(), requests: 0 }
    }

    /// Frames that may wait for the wire: those of two cycles, each with one poll for a fault.
    fn queue_length(&self) -> u32 {
        2 * (self.host_ids.len() as u32 + self.requests + 1)
    }
}

/// A CAN interface.
pub struct SocketCanBus {
    socket: CanSocket,
    link: Link,
    /// The settings of the interface before it was set up.
    before: Option<Link>,
    outgoing: Batch,
    incoming: Batch,
    realtime: RealtimeOffset,
    /// Frames that have not been received yet arrived at this instant or later.
    latest: Instant,
    /// When the last frames were sent.
    sent_at: Instant,
    /// The last value of `SO_RXQ_OVFL`.
    dropped: u32,
    /// Frames with ids of 29 bits are expected. Otherwise they are unsupported.
    accepts_extended: bool,
}

/// The error reports that the socket receives.
const ERROR_FILTER: u32 = ErrorFrame::TX_TIMEOUT
    | ErrorFrame::LOST_ARBITRATION
    | ErrorFrame::CONTROLLER
    | ErrorFrame::NO_ACKNOWLEDGE
    | ErrorFrame::BUS_OFF
    | ErrorFrame::RESTARTED;

/// Bytes of the send buffer per queued frame: `struct sk_buff` and its data block on 64-bit kernels
/// up to 6.12.
const QUEUED_FRAME_BYTES: u32 = 768;

impl SocketCanBus {
    /// Configures the interface as far as permitted, checks it, and opens it. Not for the real-time
    /// thread: it allocates, and takes milliseconds. After [`Refusal::Gone`], open again.
    ///
    /// # Errors
    ///
    /// The error of the interface, with the commands that correct it.
    pub fn open(settings: &Settings) -> Result<Self, OpenError> {
        let interface = settings.interface;
        let (link, before) =
            Link::prepare(interface, settings.index, settings.bitrate, settings.queue_length())?;
        let filters = words(&settings.host_ids);
        let configure = |socket: &CanSocket| configure(socket, &filters, settings.queue_length());
        let socket = open_socket(interface, link.index, configure)?;
        let accepts_extended = settings.host_ids.iter().any(|ids| ids.is_extended());
        Ok(Self { before, accepts_extended, ..Self::new(socket, link) })
    }

    /// Opens an interface without changing its settings, and receives every frame of any format:
    /// for tools that search for motors.
    ///
    /// # Errors
    ///
    /// The error of the interface, with the commands that correct it.
    pub fn open_as_is(interface: InterfaceName) -> Result<Self, OpenError> {
        /// Requests that may wait for the wire.
        const QUEUE: u32 = 8;
        const DEFAULT_BITRATE: u32 = 1_000_000;
        let link = Link::read(interface)?;
        link.check(link.bitrate.unwrap_or(DEFAULT_BITRATE), QUEUE)?;
        let socket = open_socket(interface, link.index, |socket| {
            socket.set_socket_option_int(libc::SOL_CAN_RAW, libc::CAN_RAW_FD_FRAMES, 1)?;
            configure(socket, &[(0, 0)], QUEUE)
        })?;
        Ok(Self { accepts_extended: true, ..Self::new(socket, link) })
    }

    fn new(socket: CanSocket, link: Link) -> Self {
        Self {
            socket,
            link,
            before: None,
            outgoing: outgoing(),
            incoming: Batch::new(Inbox::CAPACITY, FRAME_BYTES),
            realtime: RealtimeOffset::measure(),
            latest: clock::monotonic(),
            sent_at: Instant::ZERO,
            dropped: 0,
            accepts_extended: false,
        }
    }

    /// Returns the settings of the interface when it was opened.
    #[must_use]
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// Returns remarks on the interface, for motors at `bitrate` (bit/s): the settings that
    /// [`open`](Self::open) changed, and the limitations.
    pub fn notes(&self, bitrate: u32) -> impl Iterator<Item = LinkNote> {
        let ended = self.before.iter().flat_map(move |before| before.ended(bitrate));
        ended.chain(self.link.notes(bitrate))
    }

    /// Replaces the received ids. Not for the real-time thread: it allocates.
    ///
    /// # Errors
    ///
    /// [`OpenError::System`]: the kernel rejects the filters. The previous ones stay.
    pub fn listen(&mut self, ids: &[IdFilter]) -> Result<(), OpenError> {
        let set = self.socket.set_filters(&words(ids));
        set.map_err(|error| failed(self.link.interface, &error))?;
        self.accepts_extended = ids.iter().any(|ids| ids.is_extended());
        Ok(())
    }

    /// Sends `error` on a virtual interface, where every other socket receives it as the
    /// controller's own report. For simulated motors. A real controller refuses it or sends an
    /// arbitrary frame.
    pub fn report(&mut self, error: &ErrorFrame) -> Sent {
        self.outgoing.put(0, wire::encode_error(error));
        send_first(&mut self.outgoing, self.socket.as_fd(), 1)
    }
}

/// Returns the memory of the frames that one call sends.
fn outgoing() -> Batch {
    Batch::new(Inbox::CAPACITY, CLASSIC_BYTES)
}

/// Sends the frames that fit, up to the first that is not classic. One system call.
fn send(outgoing: &mut Batch, socket: BorrowedFd<'_>, frames: &[Frame]) -> Sent {
    if frames.is_empty() {
        return Sent::all(0);
    }
    let capacity = outgoing.capacity();
    let mut count = 0;
    for frame in frames.iter().take(capacity).take_while(|frame| frame.is_classic()) {
        outgoing.put(count, wire::encode(frame));
        count += 1;
    }
    let refused = match frames.get(count) {
        None => None,
        Some(_) if count == capacity => Some(Refusal::Full),
        Some(_) => Some(Refusal::Error(libc::EINVAL)),
    };
    if count == 0 {
        return Sent { accepted: 0, refusal: refused };
    }
    let sent = send_first(outgoing, socket, count);
    Sent { refusal: sent.refusal.or(refused), ..sent }
}

/// Sends the first `count` frames of a batch.
fn send_first(outgoing: &mut Batch, socket: BorrowedFd<'_>, count: usize) -> Sent {
    match outgoing.send(socket, count) {
        Ok(accepted) if accepted == count => Sent::all(accepted),
        Ok(accepted) => Sent { accepted, refusal: Some(Refusal::Full) },
        Err(errno) => Sent { accepted: 0, refusal: Some(refusal(errno)) },
    }
}

/// Opens a raw socket, configures it and then binds it, so that no frame arrives that the filters
/// exclude.
fn open_socket(
    interface: InterfaceName,
    index: u32,
    configure: impl FnOnce(&CanSocket) -> io::Result<()>,
) -> Result<CanSocket, OpenError> {
    let socket = raw_socket(interface)?;
    configure(&socket).map_err(|error| failed(interface, &error))?;
    bind(&socket, interface, index)?;
    Ok(socket)
}

fn raw_socket(interface: InterfaceName) -> Result<CanSocket, OpenError> {
    let raw = socket(AddressFamily::Can, SockType::Raw, SockFlag::SOCK_CLOEXEC, SockProtocol::CanRaw);
    raw.map(CanSocket::from).map_err(|errno| failed(interface, &errno.into()))
}

fn bind(socket: &CanSocket, interface: InterfaceName, index: u32) -> Result<(), OpenError> {
    let address = CanAddr::new(index).into_sock_addr();
    socket.as_raw_socket().bind(&address).map_err(|error| match errno(&error) {
        Errno::ENODEV => OpenError::NotCan(interface),
        _ => failed(interface, &error),
    })
}

fn failed(interface: InterfaceName, error: &io::Error) -> OpenError {
    OpenError::System { interface, step: Step::Socket, errno: errno(error) }
}

fn configure(socket: &CanSocket, filters: &[(u32, u32)], queue_length: u32) -> io::Result<()> {
    socket.set_filters(filters)?;
    socket.set_error_filter(ERROR_FILTER)?;
    socket.set_recv_own_msgs(false)?;
    socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_TIMESTAMPNS, 1)?;
    socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_RXQ_OVFL, 1)?;
    limit_queue(socket, queue_length)
}

/// Returns the kernel's filters. It finds one for a single id by a table lookup.
fn words(ids: &[IdFilter]) -> Vec<(u32, u32)> {
    ids.iter().map(|ids| ids.words()).collect()
}

/// Limits the frames that wait for the wire to `frames`.
fn limit_queue(socket: &CanSocket, frames: u32) -> io::Result<()> {
    // The kernel doubles this value.
    let send_buffer = frames.saturating_mul(QUEUED_FRAME_BYTES) / 2;
    socket.as_raw_socket().set_send_buffer_size(send_buffer as usize)
}

impl Bus for SocketCanBus {
    /// One `sendmmsg`. When the kernel takes only some frames, it returns no reason. The refusal is
    /// then [`Refusal::Full`], and the next call returns the true reason.
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        self.sent_at = now;
        send(&mut self.outgoing, self.socket.as_fd(), frames)
    }

    /// One `recvmmsg`. `now` is the time after the wait of the caller: no arrival is later. An
    /// error of the interface is not reported here; the next [`send`](Self::send) returns it.
    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        let free = inbox.free();
        if free == 0 {
            return;
        }
        let Self { socket, incoming, realtime, latest, sent_at, dropped, accepts_extended, .. } = self;
        let count = incoming.receive(socket.as_fd(), free).unwrap_or(0);
        realtime.refresh(now);
        for message in incoming.messages(count) {
            let ancillary = wire::ancillary(message.control());
            *latest = match ancillary.stamp {
                Some(stamp) => realtime.monotonic(stamp, *latest, *sent_at, now),
                None => now,
            };
            if let Some(lost) = ancillary.dropped {
                inbox.lost = inbox.lost.saturating_add(lost.wrapping_sub(*dropped));
                *dropped = lost;
            }
            let message = (message.frame_bytes(), message.classic());
            let has_space = wire::deliver(*latest, message, *accepts_extended, inbox);
            assert!(has_space, "no more messages were asked for than fit");
        }
        if count < free {
            *latest = now;
        }
    }

    fn readiness(&self) -> Readiness<'_> {
        Readiness::Readable(self.socket.as_fd())
    }
}

fn refusal(errno: Errno) -> Refusal {
    match errno {
        Errno::ENOBUFS | Errno::EAGAIN => Refusal::Full,
        Errno::ENETDOWN => Refusal::Down,
        Errno::ENODEV | Errno::ENXIO | Errno::EIO => Refusal::Gone,
        other => Refusal::Error(other as i32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_errno_of_an_interface_means_its_refusal() {
        let table = [
            (Errno::ENOBUFS, Refusal::Full),
            (Errno::EAGAIN, Refusal::Full),
            (Errno::ENETDOWN, Refusal::Down),
            (Errno::ENODEV, Refusal::Gone),
            (Errno::ENXIO, Refusal::Gone),
            (Errno::EIO, Refusal::Gone),
            (Errno::EINTR, Refusal::Error(libc::EINTR)),
            (Errno::EPERM, Refusal::Error(libc::EPERM)),
        ];
        for (errno, expected) in table {
            assert_eq!(refusal(errno), expected);
        }
    }
}
