//! Number of frames, or time, for which an adapter delays its interrupt: `ethtool -c`.

use neli::consts::nl::NlmF;
use neli::consts::socket::NlFamily;
use neli::genl::{AttrTypeBuilder, Genlmsghdr, GenlmsghdrBuilder, NlattrBuilder};
use neli::nl::{NlPayload, NlmsghdrBuilder};
use neli::socket::synchronous::NlSocketHandle;
use neli::types::{Buffer, GenlBuffer};
use neli::utils::Groups;
use nix::errno::Errno;

use super::InterfaceName;

/// A generic netlink message: a command and its attributes.
type Message = Genlmsghdr<u8, u16>;
type Attributes = GenlBuffer<u16, Buffer>;

/// From the kernel's `genetlink.h`: the family that resolves the ids of the others.
const CONTROL: u16 = 16;
const GET_FAMILY: u8 = 3;
const FAMILY_ID: u16 = 1;
const FAMILY_NAME: u16 = 2;

/// From the kernel's `ethtool_netlink.h`.
const COALESCE_GET: u8 = 19;
const HEADER: u16 = 1;
const DEVICE_NAME: u16 = 2;
const RX_USECS: u16 = 2;
const RX_FRAMES: u16 = 3;
const RX_USECS_IRQ: u16 = 4;
const RX_FRAMES_IRQ: u16 = 5;

/// Delay before a driver delivers received frames; `None` for a setting that it does not have. Each
/// pair sets a number of frames and a time in µs after the first one; the driver delivers at the
/// first limit. 0 disables a limit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Coalescing {
    /// `rx-usecs`, µs.
    pub rx_usecs: Option<u32>,
    /// `rx-frames`.
    pub rx_frames: Option<u32>,
    /// `rx-usecs-irq`, µs: applies while an interrupt is served.
    pub rx_usecs_irq: Option<u32>,
    /// `rx-frames-irq`: applies while an interrupt is served.
    pub rx_frames_irq: Option<u32>,
}

impl Coalescing {
    /// Reads the settings from the kernel. `None` where the driver has no such settings. Needs no
    /// privileges; sends two messages of netlink, not for the real-time thread.
    ///
    /// # Errors
    ///
    /// The error of the kernel: `ENODEV` for a missing interface, `ENOENT` from a kernel without
    /// ethtool's netlink.
    pub fn read(interface: InterfaceName) -> Result<Option<Self>, Errno> {
        let socket =
            NlSocketHandle::connect(NlFamily::Generic, None, Groups::empty()).map_err(|_| Errno::EPROTO)?;
        let ethtool = ask(&socket, CONTROL, GET_FAMILY, text(FAMILY_NAME, "ethtool"))?;
        let ethtool = ethtool.attrs().get_attr_handle().get_attr_payload_as(FAMILY_ID);
        let ethtool = ethtool.map_err(|_| Errno::EPROTO)?;
        match ask(&socket, ethtool, COALESCE_GET, header(interface)) {
            Ok(reply) => Ok(Some(Self::of(&reply))),
            Err(Errno::EOPNOTSUPP) => Ok(None),
            Err(errno) => Err(errno),
        }
    }

    fn of(reply: &Message) -> Self {
        let attributes = reply.attrs().get_attr_handle();
        let value = |kind| attributes.get_attr_payload_as::<u32>(kind).ok();
        Self {
            rx_usecs: value(RX_USECS),
            rx_frames: value(RX_FRAMES),
            rx_usecs_irq: value(RX_USECS_IRQ),
            rx_frames_irq: value(RX_FRAMES_IRQ),
        }
    }
}

/// Sends a request to a family, and waits for its reply.
fn ask(
    socket: &NlSocketHandle,
    family: u16,
    command: u8,
    attributes: Option<Attributes>,
) -> Result<Message, Errno> {
    let exchanged = || {
        let payload = GenlmsghdrBuilder::default().cmd(command).version(1).attrs(attributes?).build().ok()?;
        let request = NlmsghdrBuilder::default()
            .nl_type(family)
            .nl_flags(NlmF::REQUEST)
            .nl_payload(NlPayload::Payload(payload))
            .build()
            .ok()?;
        socket.send(&request).ok()?;
        let (mut replies, _) = socket.recv::<u16, Message>().ok()?;
        Some(match replies.next()?.ok()?.nl_payload() {
            NlPayload::Payload(reply) => Ok(reply.clone()),
            NlPayload::Err(refusal) => Err(Errno::from_raw(refusal.error().saturating_neg())),
            _ => Err(Errno::EPROTO),
        })
    };
    exchanged().unwrap_or(Err(Errno::EPROTO))
}

/// Returns one attribute with a text.
fn text(kind: u16, value: &str) -> Option<Attributes> {
    let kind = AttrTypeBuilder::default().nla_type(kind).build().ok()?;
    let attribute = NlattrBuilder::default().nla_type(kind).nla_payload(value).build().ok()?;
    Some(std::iter::once(attribute).collect())
}

/// Returns the attributes of a request to ethtool: a header with the interface.
fn header(interface: InterfaceName) -> Option<Attributes> {
    let kind = AttrTypeBuilder::default().nla_type(HEADER).nla_nested(true).build().ok()?;
    let name = text(DEVICE_NAME, interface.as_str())?;
    let header = NlattrBuilder::default().nla_type(kind).nla_payload(name).build().ok()?;
    Some(std::iter::once(header).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ethtool_reports_coalescing_or_missing_interface() {
        let read = |name: &str| Coalescing::read(name.parse().unwrap());
        // Without the kernel's `CONFIG_ETHTOOL_NETLINK` there is no such family.
        if read("lo") != Err(Errno::ENOENT) {
            assert_eq!(read("lo"), Ok(None));
            assert_eq!(read("nosuchcan9"), Err(Errno::ENODEV));
        }
    }
}
