//! The process that holds a lock of a bus, found without its help.
//!
//! A connection shows the process that listens. A process hides if it never listens, or if its
//! queue of connections is full, which any user can bring about. The kernel's table of sockets
//! still shows its user.

use core::fmt::{self, Display, Formatter};
use std::os::fd::{AsRawFd, OwnedFd};
use std::time::Duration;

use nix::errno::Errno;
use nix::sys::socket::{
    AddressFamily, MsgFlags, SockFlag, SockProtocol, SockType, UnixAddr, connect, getsockopt, recv, send,
    setsockopt, socket, sockopt,
};
use nix::sys::time::TimeVal;
use nix::time::{ClockId, clock_gettime};

/// Longest search in the table of sockets, processor time: a search that a loaded machine interrupts
/// still finds the user. A table of 1000 sockets takes a millisecond.
const SEARCH_MAX: Duration = Duration::from_millis(20);

/// The process that holds a bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Holder {
    /// Its process id. `None` when it is in another process namespace, hides, or is just taking the
    /// lock.
    pub pid: Option<u32>,
    /// Its user, as the kernel recorded it. `None` when it hides, or is just taking the lock.
    pub uid: Option<u32>,
}

impl Holder {
    /// A process that no connection shows.
    pub(crate) const HIDDEN: Self = Self { pid: None, uid: None };

    /// Returns what to do so that the lock becomes free, as the end of a sentence.
    #[must_use]
    pub fn remedy(&self) -> String {
        match self.pid {
            Some(pid) => format!("stop that process first: `sudo kill {pid}`"),
            None => "find that process with `sudo ss -xap | grep motord/`, and stop it first".to_owned(),
        }
    }
}

/// Reads the program's name from `/proc`: it may be that of a later process with the same id.
impl Display for Holder {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self.pid {
            Some(pid) => write!(f, "process {pid}")?,
            None => f.write_str("another process")?,
        }
        if let Some(program) = self.pid.and_then(program) {
            write!(f, " ({program})")?;
        }
        self.uid.map_or(Ok(()), |uid| write!(f, " of user {uid}"))
    }
}

/// Returns the name of the program of process `pid`. The process chooses it, so other characters
/// than printable ASCII are omitted.
fn program(pid: u32) -> Option<String> {
    let name = std::fs::read(format!("/proc/{pid}/comm")).ok()?;
    let name: String =
        name.iter().filter(|byte| (b' '..=b'~').contains(byte)).map(|byte| *byte as char).collect();
    (!name.is_empty()).then_some(name)
}

/// Returns the process that listens at the abstract name `name`; `None` without one. The kernel
/// stores its credentials, so it need not accept connections. Four system calls; does not block.
pub(crate) fn listener(name: &[u8]) -> Option<Holder> {
    let socket = open().ok()?;
    match connect(socket.as_raw_fd(), &UnixAddr::new_abstract(name).ok()?) {
        Ok(()) => Some(getsockopt(&socket, sockopt::PeerCredentials).map_or(Holder::HIDDEN, |peer| Holder {
            pid: u32::try_from(peer.pid()).ok().filter(|pid| *pid != 0),
            uid: Some(peer.uid()),
        })),
        Err(Errno::EAGAIN) => Some(Holder::HIDDEN),
        Err(_) => None,
    }
}

/// Opens a socket of the type of the locks.
pub(crate) fn open() -> nix::Result<OwnedFd> {
    let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
    socket(AddressFamily::Unix, SockType::Stream, flags, None)
}

/// Returns the user who bound the abstract name `name`, listening or not; `None` without one, and
/// where the kernel does not tell (before Linux 5.3, or without `unix_diag`). Allocates, and takes
/// at most 40 ms of processor time.
pub(crate) fn owner(name: &[u8]) -> Option<u32> {
    let end = processor_time()? + SEARCH_MAX;
    let table = ask_for_table().ok()?;
    let name = [b"\0", name].concat();
    let mut messages = vec![0; 64 * 1024];
    while processor_time()? < end {
        let length = recv(table.as_raw_fd(), &mut messages, MsgFlags::empty()).ok()?;
        match owner_in(&messages[..length], &name) {
            Search::Found(uid) => return Some(uid),
            Search::Continues => {}
            Search::Over => return None,
        }
    }
    None
}

/// Returns the processor time that this thread has taken.
fn processor_time() -> Option<Duration> {
    clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).ok().map(Duration::from)
}

/// Layouts and numbers of `linux/netlink.h`, `linux/sock_diag.h` and `linux/unix_diag.h`.
const SOCK_DIAG_BY_FAMILY: u16 = 20;
const REQUEST_DUMP: u16 = 0x301;
const HEADER_BYTES: usize = 16;
const SOCKET_BYTES: usize = 16;
const ATTRIBUTE_BYTES: usize = 4;
const ATTRIBUTE_NAME: u16 = 0;
const ATTRIBUTE_UID: u16 = 7;
const SHOW_NAME_AND_UID: u32 = 1 | 1 << 6;
/// Sockets that listen (10), and those that do not yet (7).
const STATES: u32 = 1 << 10 | 1 << 7;

/// Requests the bound Unix sockets of this network namespace.
fn ask_for_table() -> nix::Result<OwnedFd> {
    let table =
        socket(AddressFamily::Netlink, SockType::Raw, SockFlag::SOCK_CLOEXEC, SockProtocol::NetlinkSockDiag)?;
    setsockopt(&table, sockopt::ReceiveTimeout, &TimeVal::new(0, i64::from(SEARCH_MAX.subsec_micros())))?;
    let body = [&[libc::AF_UNIX as u8, 0, 0, 0][..], &words([STATES, 0, SHOW_NAME_AND_UID, 0, 0])].concat();
    let length = (HEADER_BYTES + body.len()) as u32;
    let kind = [SOCK_DIAG_BY_FAMILY.to_ne_bytes(), REQUEST_DUMP.to_ne_bytes()].concat();
    let header = [&words([length])[..], &kind, &words([1, 0])].concat();
    send(table.as_raw_fd(), &[header, body].concat(), MsgFlags::empty())?;
    Ok(table)
}

fn words<const N: usize>(values: [u32; N]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_ne_bytes()).collect()
}

#[derive(Debug, PartialEq, Eq)]
enum Search {
    Found(u32),
    Continues,
    Over,
}

/// Searches a part of the table, messages of netlink, for the name.
fn owner_in(mut messages: &[u8], name: &[u8]) -> Search {
    while let Some((length, kind)) = u32_at(messages, 0).zip(u16_at(messages, 4)) {
        let length = length as usize;
        if kind != SOCK_DIAG_BY_FAMILY || length < HEADER_BYTES || length > messages.len() {
            return Search::Over;
        }
        let attributes = messages[..length].get(HEADER_BYTES + SOCKET_BYTES..).unwrap_or_default();
        // A name belongs to one kind of socket: another user may hold it for each other kind.
        let is_lock = messages[..length].get(HEADER_BYTES + 1) == Some(&(libc::SOCK_STREAM as u8));
        if is_lock && attribute(attributes, ATTRIBUTE_NAME) == Some(name) {
            let uid = attribute(attributes, ATTRIBUTE_UID).and_then(|uid| u32_at(uid, 0));
            return uid.map_or(Search::Over, Search::Found);
        }
        messages = messages.get(length.next_multiple_of(4)..).unwrap_or_default();
    }
    Search::Continues
}

/// Returns the value of the first attribute of this kind.
fn attribute(mut attributes: &[u8], kind: u16) -> Option<&[u8]> {
    loop {
        let (length, found) = (usize::from(u16_at(attributes, 0)?), u16_at(attributes, 2)?);
        let value = attributes.get(ATTRIBUTE_BYTES..length)?;
        if found == kind {
            return Some(value);
        }
        attributes = attributes.get(length.next_multiple_of(4)..)?;
    }
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..at + 2)?.try_into().ok().map(u16::from_ne_bytes)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..at + 4)?.try_into().ok().map(u32::from_ne_bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nix::sys::socket::{Backlog, bind, listen};
    use nix::unistd::Uid;

    fn bound(name: &str) -> OwnedFd {
        let socket = open().unwrap();
        bind(socket.as_raw_fd(), &UnixAddr::new_abstract(name.as_bytes()).unwrap()).unwrap();
        socket
    }

    fn unique(name: &str) -> String {
        format!("motord-test/{name}/{}", std::process::id())
    }

    /// A process that never listens, and one whose queue is full, refuse every connection.
    #[test]
    fn user_of_hidden_holder_is_known() {
        let name = unique("hidden");
        assert_eq!(owner(name.as_bytes()), None);
        let socket = bound(&name);
        let user = Some(Uid::effective().as_raw());
        assert_eq!((listener(name.as_bytes()), owner(name.as_bytes())), (None, user));
        listen(&socket, Backlog::new(1).unwrap()).unwrap();
        let shown = Some(Holder { pid: Some(std::process::id()), uid: user });
        assert_eq!(listener(name.as_bytes()), shown);
        while listener(name.as_bytes()) == shown {}
        assert_eq!((listener(name.as_bytes()), owner(name.as_bytes())), (Some(Holder::HIDDEN), user));
    }

    /// Another user may hold the name of a lock for each other kind of socket.
    #[test]
    fn only_sockets_of_locks_kind_have_owner() {
        let name = unique("decoy");
        let address = UnixAddr::new_abstract(name.as_bytes()).unwrap();
        let decoys = [SockType::Datagram, SockType::SeqPacket].map(|kind| {
            let decoy = socket(AddressFamily::Unix, kind, SockFlag::SOCK_CLOEXEC, None).unwrap();
            bind(decoy.as_raw_fd(), &address).unwrap();
            decoy
        });
        assert_eq!(owner(name.as_bytes()), None);
        let _lock = bound(&name);
        assert_eq!(owner(name.as_bytes()), Some(Uid::effective().as_raw()));
        drop(decoys);
    }

    #[test]
    fn owner_is_found_among_thousand_names() {
        let sockets: Vec<_> = (0..1000).map(|number| bound(&unique(&format!("many-{number}")))).collect();
        assert_eq!(owner(unique("many-999").as_bytes()), Some(Uid::effective().as_raw()));
        assert_eq!(owner(unique("many-1000").as_bytes()), None);
        drop(sockets);
    }

    #[test]
    fn malformed_table_names_no_user() {
        for length in 0..64_u32 {
            let mut message =
                [&words([length])[..], &SOCK_DIAG_BY_FAMILY.to_ne_bytes(), &[0xFF; 58]].concat();
            let _any_but_a_panic = owner_in(&message, b"name");
            message.truncate(length as usize);
            assert!(!matches!(owner_in(&message, b"name"), Search::Found(_)), "{length}");
        }
    }

    /// A process chooses its name, and may put escapes of a terminal into it.
    #[test]
    fn holder_is_named_with_program_and_user() {
        let holder = Holder { pid: Some(std::process::id()), uid: Some(7) };
        let text = holder.to_string();
        assert!(text.starts_with(&format!("process {} (", std::process::id())), "{text}");
        assert!(text.ends_with(") of user 7") && text.chars().all(|letter| !letter.is_control()), "{text}");
        assert_eq!(Holder::HIDDEN.to_string(), "another process");
    }
}
