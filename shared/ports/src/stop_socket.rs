//! The socket of a daemon for emergency stops: it needs no file, no slot and no memory that other
//! processes could exhaust.
//!
//! It is an abstract Unix socket (unix(7)) of the type `SOCK_SEQPACKET`, called
//! `motord-stop:<instance>:<runtime directory>`. A requester connects, sends [`REQUEST`], and
//! receives one of the replies. A line break and a text may follow the request: its
//! [source](crate::stop_source). A connection without a request has no effect. Abstract sockets
//! exist per network namespace.
//!
//! Any process may take a free name. Therefore a requester trusts only users who could also answer
//! in the runtime directory.

use crate::instance::Instance;
use crate::peer::Impostor;
use crate::stop_source::{REQUEST_BYTES_MAX, StopSource};
use nix::errno::Errno;
use nix::poll::{PollTimeout, poll};
use nix::sys::socket::{
    AddressFamily, MsgFlags, SockFlag, SockType, UnixAddr, UnixCredentials, connect, getsockopt, recv, send,
    setsockopt, socket, sockopt,
};
use nix::sys::stat::{FileStat, lstat, stat};
use nix::sys::time::TimeVal;
use nix::unistd::Uid;
use std::ffi::CString;
use std::fs;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::time::{Duration, Instant};

pub use crate::stop_source::REQUEST;

/// The reply once the commands that damp the motors are sent.
pub const CONFIRMED: &[u8] = b"confirmed";
/// The reply when no cycle executed the stop in time. The next cycle, if any, still executes it.
pub const NO_CYCLE: &[u8] = b"no cycle";
/// The reply to a process that may not enter the runtime directory.
pub const NOT_PERMITTED: &[u8] = b"not permitted";

/// Longest message of either side.
pub const MESSAGE_BYTES_MAX: usize = 160;

pub(crate) const PREFIX: &[u8] = b"motord-stop:";
/// Pause between two attempts to reach a daemon that has too many connections.
const RETRY: Duration = Duration::from_millis(RETRY_MS as u64);
const RETRY_MS: u8 = 1;

/// The reason why an emergency stop was not confirmed through the socket.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum StopError {
    /// No process listens.
    #[error("no motord listens in this network namespace")]
    NotRunning,
    /// A process of another user listens instead of the daemon.
    #[error(transparent)]
    NotTrusted(Impostor),
    /// The daemon rejects requests of this user.
    #[error("this user may not enter motord's runtime directory")]
    NotPermitted,
    /// The daemon answers, but its cycle did not execute the stop.
    #[error("motord's cycle does not run")]
    NoCycle,
    /// The daemon did not answer in time.
    #[error("motord does not answer")]
    NoReply,
    /// The system returned an error for the socket.
    #[error("cannot create or use a socket: {0}")]
    System(Errno),
}

/// Returns the address of an instance's socket.
///
/// # Errors
/// `ENAMETOOLONG` when the real path of the runtime directory is much longer than the given one.
pub fn address(instance: &Instance) -> Result<UnixAddr, Errno> {
    let runtime = instance.runtime();
    let real = fs::canonicalize(runtime).or_else(|_| std::path::absolute(runtime));
    let runtime = real.unwrap_or_else(|_| runtime.to_owned());
    let name = [PREFIX, instance.name().as_bytes(), b":", runtime.as_os_str().as_bytes()].concat();
    UnixAddr::new_abstract(&name)
}

/// Returns the process that has the name of an instance's socket. `None` without one, and where its
/// queue is full. Does not block.
#[must_use]
pub fn holder(instance: &Instance) -> Option<Impostor> {
    let socket = open(SockFlag::SOCK_NONBLOCK).ok()?;
    connect(socket.as_raw_fd(), &address(instance).ok()?).ok()?;
    let peer = getsockopt(&socket, sockopt::PeerCredentials).ok()?;
    Some(Impostor { pid: peer.pid(), uid: peer.uid() })
}

/// Creates a socket of this type, not connected yet.
///
/// # Errors
/// Those of the system.
pub fn open(flags: SockFlag) -> Result<OwnedFd, Errno> {
    socket(AddressFamily::Unix, SockType::SeqPacket, SockFlag::SOCK_CLOEXEC | flags, None)
}

/// Everything that a request for an emergency stop needs, found beforehand.
///
/// [`stop`](Self::stop) is async-signal-safe, as is [`send`](Self::send): they use the stack and
/// system calls of the list in signal-safety(7) only. They allocate nothing, take no lock, and need
/// one free file descriptor.
#[derive(Debug, Clone)]
pub struct StopPath {
    address: UnixAddr,
    /// The runtime directory and the lock, whose owners may answer. `None` where the directory must
    /// belong to this user: see [`TrustedUsers::and_of`](crate::TrustedUsers::and_of).
    shared: Option<[CString; 2]>,
}

impl StopPath {
    /// Finds the paths of `instance`. They stay valid when another daemon starts.
    ///
    /// # Errors
    /// Those of [`address`]; `EINVAL` for a path with a null byte.
    pub fn of(instance: &Instance) -> Result<Self, Errno> {
        let text = |path: &Path| CString::new(path.as_os_str().as_bytes()).map_err(|_| Errno::EINVAL);
        let [runtime, lock] = [text(instance.runtime())?, text(&instance.lock_path())?];
        Ok(Self { address: address(instance)?, shared: (!instance.is_private()).then_some([runtime, lock]) })
    }

    /// Requests the daemon to damp and stop every motor, and waits at most `timeout` for the
    /// request, and again for the confirmation. Async-signal-safe, and keeps `errno`.
    ///
    /// # Errors
    /// The stop is unconfirmed: those of [`send`](Self::send) and [`AskedStop::confirm`].
    pub fn stop(&self, timeout: Duration) -> Result<(), StopError> {
        let errno = Errno::last_raw();
        let outcome = self.send(timeout).and_then(|asked| asked.confirm(timeout));
        Errno::set_raw(errno);
        outcome
    }

    /// Requests the daemon to damp and stop every motor. Waits at most `timeout` until the request
    /// is sent. Async-signal-safe.
    ///
    /// # Errors
    /// [`StopError::NotRunning`], [`StopError::NoReply`], [`StopError::System`].
    pub fn send(&self, timeout: Duration) -> Result<AskedStop, StopError> {
        self.send_for(&StopSource::NONE, timeout)
    }

    /// As [`send`](Self::send), for `source`.
    ///
    /// # Errors
    /// Those of [`send`](Self::send).
    pub fn send_for(&self, source: &StopSource, timeout: Duration) -> Result<AskedStop, StopError> {
        let end = Instant::now() + timeout;
        loop {
            match self.try_send(source, end) {
                // A daemon with too many callers drops the first ones without a request: this
                // process may be affected.
                Err(Errno::EPIPE | Errno::ECONNRESET | Errno::EAGAIN | Errno::EINTR)
                    if Instant::now() < end =>
                {
                    let _interrupted = poll(&mut [], PollTimeout::from(RETRY_MS));
                }
                Err(Errno::EPIPE | Errno::ECONNRESET | Errno::EAGAIN | Errno::EINTR) => {
                    return Err(StopError::NoReply);
                }
                Err(Errno::ECONNREFUSED) => return Err(StopError::NotRunning),
                other => return other.map_err(StopError::System),
            }
        }
    }

    fn try_send(&self, source: &StopSource, end: Instant) -> Result<AskedStop, Errno> {
        let socket = connected(&self.address, end)?;
        let mut message = [0; REQUEST_BYTES_MAX];
        send(socket.as_raw_fd(), source.request(&mut message), MsgFlags::MSG_NOSIGNAL)?;
        let daemon = self.check_peer(getsockopt(&socket, sockopt::PeerCredentials)?);
        Ok(AskedStop { socket, daemon })
    }

    /// Checks that the listening process can be the daemon: a process that is [no
    /// impostor](crate::peer), or of the owner of the lock in a shared directory.
    pub(crate) fn check_peer(&self, peer: UnixCredentials) -> Result<(), StopError> {
        let owns = |found: nix::Result<FileStat>| found.is_ok_and(|found| found.st_uid == peer.uid());
        let is_owner =
            |[runtime, lock]: &[CString; 2]| owns(stat(runtime.as_c_str())) || owns(lstat(lock.as_c_str()));
        let is_trusted = [0, Uid::effective().as_raw()].contains(&peer.uid())
            || self.shared.as_ref().is_some_and(is_owner);
        match is_trusted {
            true => Ok(()),
            false => Err(StopError::NotTrusted(Impostor { pid: peer.pid(), uid: peer.uid() })),
        }
    }
}

/// A requested emergency stop.
#[derive(Debug)]
pub struct AskedStop {
    socket: OwnedFd,
    /// Result of the check of the listening process. After an error none of its answers is trusted.
    daemon: Result<(), StopError>,
}

impl AskedStop {
    /// Requests the daemon of `instance` to damp and stop every motor. Waits at most `timeout`
    /// until the request is sent.
    ///
    /// # Errors
    /// [`StopError::NotRunning`], [`StopError::NoReply`], [`StopError::System`].
    pub fn send(instance: &Instance, timeout: Duration) -> Result<Self, StopError> {
        Self::send_for(instance, &StopSource::NONE, timeout)
    }

    /// As [`send`](Self::send), for `source`.
    ///
    /// # Errors
    /// Those of [`send`](Self::send).
    pub fn send_for(instance: &Instance, source: &StopSource, timeout: Duration) -> Result<Self, StopError> {
        StopPath::of(instance).map_err(StopError::System)?.send_for(source, timeout)
    }

    /// Waits for the confirmation, at most `timeout`. Async-signal-safe.
    ///
    /// # Errors
    /// [`StopError::NoReply`] when the confirmation may still arrive; every other error is final.
    /// [`StopError::NotTrusted`] for every answer of a process that cannot be the daemon.
    pub fn confirm(&self, timeout: Duration) -> Result<(), StopError> {
        let end = Instant::now() + timeout;
        let mut reply = [0; MESSAGE_BYTES_MAX];
        loop {
            wait_at_most(&self.socket, end).map_err(StopError::System)?;
            return match recv(self.socket.as_raw_fd(), &mut reply, MsgFlags::empty()) {
                Ok(_) | Err(Errno::ECONNRESET) if self.daemon.is_err() => self.daemon,
                Ok(length) if reply[..length] == *CONFIRMED => Ok(()),
                Ok(length) if reply[..length] == *NO_CYCLE => Err(StopError::NoCycle),
                Ok(length) if reply[..length] == *NOT_PERMITTED => Err(StopError::NotPermitted),
                Ok(_) | Err(Errno::ECONNRESET) => Err(StopError::NotRunning),
                Err(Errno::EINTR) => continue,
                Err(Errno::EAGAIN) => Err(StopError::NoReply),
                Err(errno) => Err(StopError::System(errno)),
            };
        }
    }
}

fn connected(address: &UnixAddr, end: Instant) -> Result<OwnedFd, Errno> {
    let socket = open(SockFlag::empty())?;
    wait_at_most(&socket, end)?;
    connect(socket.as_raw_fd(), address)?;
    Ok(socket)
}

/// Limits each call on `socket` to `end` plus at most a millisecond.
fn wait_at_most(socket: &OwnedFd, end: Instant) -> Result<(), Errno> {
    let left = end.saturating_duration_since(Instant::now()).max(RETRY);
    let left = TimeVal::new(left.as_secs() as i64, i64::from(left.subsec_micros()));
    setsockopt(socket, sockopt::SendTimeout, &left)?;
    setsockopt(socket, sockopt::ReceiveTimeout, &left)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nix::sys::socket::{Backlog, accept, bind, listen};

    fn listening(instance: &Instance) -> OwnedFd {
        let socket = open(SockFlag::empty()).unwrap();
        bind(socket.as_raw_fd(), &address(instance).unwrap()).unwrap();
        listen(&socket, Backlog::new(8).unwrap()).unwrap();
        socket
    }

    fn asked(answer: impl FnOnce(i32) + Send + 'static) -> Result<(), StopError> {
        let directory = tempfile::tempdir().unwrap();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        let daemon = listening(&instance);
        let daemon = std::thread::spawn(move || {
            let caller = accept(daemon.as_raw_fd()).unwrap();
            assert_eq!(recv(caller, &mut [0; MESSAGE_BYTES_MAX], MsgFlags::empty()), Ok(REQUEST.len()));
            answer(caller);
            nix::unistd::close(caller).unwrap();
        });
        let asked = AskedStop::send(&instance, Duration::from_secs(5)).unwrap();
        let outcome = asked.confirm(Duration::from_millis(200));
        daemon.join().unwrap();
        outcome
    }

    fn replies(reply: &'static [u8]) -> impl FnOnce(i32) + Send + 'static {
        move |caller| assert_eq!(send(caller, reply, MsgFlags::empty()), Ok(reply.len()))
    }

    #[test]
    fn only_a_confirmation_confirms() {
        assert_eq!(asked(replies(CONFIRMED)), Ok(()));
        assert_eq!(asked(replies(NO_CYCLE)), Err(StopError::NoCycle));
        assert_eq!(asked(replies(NOT_PERMITTED)), Err(StopError::NotPermitted));
        assert_eq!(asked(replies(b"confirmed!")), Err(StopError::NotRunning));
        assert_eq!(asked(|_| ()), Err(StopError::NotRunning), "it closed the connection");
        let sleeps = |_| std::thread::sleep(Duration::from_millis(400));
        assert_eq!(asked(sleeps), Err(StopError::NoReply));
    }

    /// A refusal would end the search for another path, and hide that the robot still moves.
    #[test]
    fn no_answer_of_an_impostor_is_believed() {
        let impostor = Err(StopError::NotTrusted(Impostor { pid: 7, uid: 54_321 }));
        for answer in [CONFIRMED, NO_CYCLE, NOT_PERMITTED, b"else", b""] {
            let (daemon, socket) = nix::sys::socket::socketpair(
                AddressFamily::Unix,
                SockType::SeqPacket,
                None,
                SockFlag::empty(),
            )
            .unwrap();
            send(daemon.as_raw_fd(), answer, MsgFlags::empty()).unwrap();
            let asked = AskedStop { socket, daemon: impostor };
            assert_eq!(asked.confirm(Duration::from_secs(5)), impostor, "{answer:?}");
        }
    }

    #[test]
    fn a_process_of_another_user_is_not_believed() {
        let directory = tempfile::tempdir().unwrap();
        let instance = Instance::below(directory.path(), "robot").unwrap();
        let of = |uid| UnixCredentials::from(nix::libc::ucred { pid: 7, uid, gid: 0 });
        let path = StopPath::of(&instance).unwrap();
        assert_eq!(path.check_peer(of(0)), Ok(()));
        assert_eq!(path.check_peer(of(Uid::effective().as_raw())), Ok(()));
        assert_eq!(path.check_peer(of(54_321)), Err(StopError::NotTrusted(Impostor { pid: 7, uid: 54_321 })));
    }
}
