//! The kernel's announcements that an interface went down or came up.
//!
//! Source: `linux/netlink.h`, `linux/rtnetlink.h` (group `RTMGRP_LINK`, `struct ifinfomsg`). The
//! bytes come from the kernel; no function here panics, for any bytes.

use std::os::fd::{AsRawFd, OwnedFd};

use nix::errno::Errno;
use nix::sys::socket::{
    AddressFamily, MsgFlags, NetlinkAddr, SockFlag, SockProtocol, SockType, bind, recv, socket,
};

/// Most messages that one call reads.
const MESSAGES_MAX: usize = 64;
/// The kernel's messages are smaller, or cut: the part in use is at the beginning.
const BUFFER_BYTES: usize = 8192;
/// `struct nlmsghdr`.
const HEADER_BYTES: usize = 16;

/// An interface that was set up, set down or changed otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Announcement {
    /// Index of the interface.
    pub index: u32,
    /// The interface is up.
    pub up: bool,
}

/// Receives what the kernel announces of all interfaces. Needs no privileges.
pub struct Announcements {
    socket: OwnedFd,
    buffer: Vec<u8>,
}

impl Announcements {
    /// Subscribes. Allocates.
    ///
    /// # Errors
    ///
    /// That of the kernel, such as for a process that may not use netlink.
    pub fn open() -> nix::Result<Self> {
        let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
        let socket = socket(AddressFamily::Netlink, SockType::Raw, flags, Some(SockProtocol::NetlinkRoute))?;
        bind(socket.as_raw_fd(), &NetlinkAddr::new(0, libc::RTMGRP_LINK as u32))?;
        Ok(Self { socket, buffer: vec![0; BUFFER_BYTES] })
    }

    /// Calls `each` with the announcements since the last call, oldest first, at most 64 messages
    /// of them. Those that the kernel had no room for are missing. Never blocks.
    pub fn take(&mut self, mut each: impl FnMut(Announcement)) {
        for _ in 0..MESSAGES_MAX {
            match recv(self.socket.as_raw_fd(), &mut self.buffer, MsgFlags::MSG_DONTWAIT) {
                Ok(bytes) => parse(&self.buffer[..bytes.min(BUFFER_BYTES)], &mut each),
                // The kernel dropped some.
                Err(Errno::ENOBUFS | Errno::EINTR) => {}
                Err(_) => return,
            }
        }
    }
}

/// Reads messages that follow each other. Bounded by their bytes.
fn parse(mut bytes: &[u8], each: &mut impl FnMut(Announcement)) {
    while let Some(length) = word(bytes, 0).and_then(|length| usize::try_from(length).ok()) {
        let message = &bytes[..length.min(bytes.len())];
        if let Some(announcement) = announcement(message) {
            each(announcement);
        }
        // Messages begin at multiples of four. One that is too short to be any ends the rest.
        let next = if length < HEADER_BYTES { bytes.len() } else { length.next_multiple_of(4) };
        bytes = bytes.get(next..).unwrap_or_default();
    }
}

/// Reads `RTM_NEWLINK`, with an `ifinfomsg` behind the header: index at 4, flags at 8.
fn announcement(message: &[u8]) -> Option<Announcement> {
    let kind = message.get(4..6)?.first_chunk().map(|kind| u16::from_ne_bytes(*kind))?;
    let (index, flags) = (word(message, HEADER_BYTES + 4)?, word(message, HEADER_BYTES + 8)?);
    let up = flags & libc::IFF_UP.cast_unsigned() != 0;
    (kind == libc::RTM_NEWLINK).then_some(Announcement { index, up })
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|word| u32::from_ne_bytes(*word))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(kind: u16, index: u32, flags: u32) -> Vec<u8> {
        let mut bytes = 32_u32.to_ne_bytes().to_vec();
        bytes.extend(kind.to_ne_bytes());
        bytes.extend([0; 10 + 4]);
        bytes.extend(index.to_ne_bytes());
        bytes.extend(flags.to_ne_bytes());
        bytes.extend([0; 4]);
        bytes
    }

    fn parsed(bytes: &[u8]) -> Vec<Announcement> {
        let mut found = Vec::new();
        parse(bytes, &mut |announcement| found.push(announcement));
        found
    }

    #[test]
    fn each_link_message_is_an_announcement() {
        let bytes = [message(16, 7, 1), message(17, 7, 0), message(16, 8, 0xFFFE)].concat();
        let expected = [(7, true), (8, false)].map(|(index, up)| Announcement { index, up });
        assert_eq!(parsed(&bytes), expected);
    }

    #[test]
    fn no_bytes_panic_or_loop() {
        let good = [message(16, 7, 1), message(16, 7, 0)].concat();
        for cut in 0..good.len() {
            assert!(parsed(&good[..cut]).len() <= 2);
        }
        for length in [0, 1, 15, 16, 31, 33, u32::MAX] {
            let mut bad = good.clone();
            bad[..4].copy_from_slice(&u32::to_ne_bytes(length));
            assert!(parsed(&bad).len() <= 2, "{length}");
        }
    }

    #[test]
    fn every_process_may_subscribe() {
        let mut announcements = Announcements::open().unwrap();
        announcements.take(|_| ());
    }
}
