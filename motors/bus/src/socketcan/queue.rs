//! Discards the frames that wait on an interface for another node to acknowledge one.
//!
//! Linux takes back no frame. When an interface goes down, the kernel drops its queue, and the
//! driver resets the controller or the adapter with its transmit buffers.

use neli::consts::nl::NlmF;
use neli::consts::rtnl::{Rtm, Tca};
use neli::consts::socket::NlFamily;
use neli::nl::{NlPayload, Nlmsghdr, NlmsghdrBuilder};
use neli::rtnl::{Tcmsg, TcmsgBuilder};
use neli::socket::synchronous::NlSocketHandle;
use neli::utils::Groups;
use socketcan::CanInterface;

use super::link::netlink_errno;
use super::{InterfaceName, Link, OpenError, Step};

/// Messages of the kernel that are read at most, in search of the queues of one interface.
const MESSAGES_MAX: usize = 4096;
/// Offset of `qlen` in `struct tc_stats` of `linux/pkt_sched.h`.
const QLEN_AT: usize = 28;

impl Link {
    /// Discards the frames that kernel and adapter keep for the wire of `interface`, by taking it
    /// down and up. With `index`, leaves an interface of another index as it is. Returns whether it
    /// did: a virtual interface without a queued frame stays up. Not for the real-time thread:
    /// takes milliseconds, and allocates.
    ///
    /// # Errors
    ///
    /// [`OpenError::Kept`] without the permission; otherwise the error of the interface.
    pub fn discard_queue(interface: InterfaceName, index: Option<u32>) -> Result<bool, OpenError> {
        let link = Self::read(interface)?;
        if index.is_some_and(|index| index != link.index) {
            return Err(OpenError::Missing(interface));
        }
        // A virtual interface has no adapter, and other programs of this computer use it as well.
        if !link.up || link.is_virtual && queued(link.index) == Some(0) {
            return Ok(false);
        }
        let device = CanInterface::open_iface(link.index);
        device.bring_down().map_err(|_| OpenError::Kept(interface))?;
        device.bring_up().map_err(|error| OpenError::System {
            interface,
            step: Step::Up,
            errno: netlink_errno(&error),
        })?;
        Ok(true)
    }
}

/// Returns the number of frames in the queues of the interface with this index; `None` where the
/// kernel does not report them.
fn queued(index: u32) -> Option<u32> {
    let index = i32::try_from(index).ok()?;
    let socket = NlSocketHandle::connect(NlFamily::Route, None, Groups::empty()).ok()?;
    socket.send(&request(index)?).ok()?;
    let (mut frames, mut messages) = (0, 0);
    while messages < MESSAGES_MAX {
        let (answers, _) = socket.recv::<Rtm, Tcmsg>().ok()?;
        for answer in answers {
            messages += 1;
            match answer.ok()?.nl_payload() {
                NlPayload::Payload(queue) if *queue.tcm_ifindex() == index => frames += length(queue)?,
                NlPayload::Payload(_) => {}
                NlPayload::DumpExtAck(_) | NlPayload::Empty => return Some(frames),
                NlPayload::Ack(_) | NlPayload::Err(_) => return None,
            }
        }
    }
    None
}

/// Returns the length of one queue, in frames.
fn length(queue: &Tcmsg) -> Option<u32> {
    let statistics = queue.rtattrs().iter().find(|attribute| *attribute.rta_type() == Tca::Stats)?;
    let bytes = statistics.rta_payload().as_ref().get(QLEN_AT..QLEN_AT + 4)?;
    Some(u32::from_ne_bytes(bytes.try_into().ok()?))
}

fn request(index: i32) -> Option<Nlmsghdr<Rtm, Tcmsg>> {
    let queue = TcmsgBuilder::default().tcm_family(0).tcm_ifindex(index);
    let queue = queue.tcm_handle(0).tcm_parent(0).tcm_info(0).build().ok()?;
    NlmsghdrBuilder::default()
        .nl_type(Rtm::Getqdisc)
        .nl_flags(NlmF::REQUEST | NlmF::DUMP)
        .nl_payload(NlPayload::Payload(queue))
        .build()
        .ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nix::net::if_::if_nametoindex;

    #[test]
    fn kernel_reports_length_of_queues() {
        let loopback = if_nametoindex("lo").unwrap();
        assert_eq!(queued(loopback), Some(0), "it has no queue");
        assert_eq!(queued(u32::MAX), None);
    }

    #[test]
    fn missing_interface_has_no_queue() {
        let name = "nosuchcan9".parse().unwrap();
        assert_eq!(Link::discard_queue(name, None), Err(OpenError::Missing(name)));
    }
}
