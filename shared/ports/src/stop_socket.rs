//! The socket of a daemon for emergency stops: a way that needs no file, no place and no memory that others could use up.
//!
//! It is an abstract Unix socket (unix(7)) of the kind `SOCK_SEQPACKET`, called `motord-stop:<instance>:<runtime directory>`. An
//! asker connects, sends [`REQUEST`], and gets one of the replies. Connecting alone asks for nothing. Like every abstract
//! socket it is there for the processes of one network namespace.
//!
//! Anybody may take a free name, so an asker believes only a process of a user who could answer in the runtime directory, too.

use crate::instance::Instance;
use nix::errno::Errno;
use nix::sys::socket::{
    AddressFamily, MsgFlags, SockFlag, SockType, UnixAddr, UnixCredentials, connect, getsockopt, recv, send,
    setsockopt, socket, sockopt,
};
use nix::sys::time::TimeVal;
use nix::unistd::Uid;
use std::fs;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The request for an emergency stop.
pub const REQUEST: &[u8] = b"motord emergency stop 1";
/// The reply once the commands that damp the motors are on their way.
pub const CONFIRMED: &[u8] = b"confirmed";
/// The reply when no cycle carried the stop out in time. The next cycle, if one comes, still carries it out.
pub const NO_CYCLE: &[u8] = b"no cycle";
/// The reply to a process that may not enter the runtime directory.
pub const NOT_PERMITTED: &[u8] = b"not permitted";

/// Longest message of either side.
pub const MESSAGE_BYTES_MAX: usize = 32;

const PREFIX: &[u8] = b"motord-stop:";
/// Pause between two attempts to reach a daemon that has too many connections.
const RETRY: Duration = Duration::from_millis(1);

/// Why an emergency stop was not confirmed through the socket.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum StopError {
    /// No process listens.
    #[error("no motord listens in this network namespace")]
    NotRunning,
    /// A process of another user listens in the place of the daemon.
    #[error("process {pid} of user {uid} listens in the place of motord")]
    NotTrusted {
        /// Its process id.
        pid: i32,
        /// Its user.
        uid: u32,
    },
    /// The daemon does not let this user stop the robot.
    #[error("this user may not enter motord's runtime directory")]
    NotPermitted,
    /// The daemon is there, and its cycle did not carry the stop out.
    #[error("motord's cycle does not run")]
    NoCycle,
    /// The daemon did not answer in time.
    #[error("motord does not answer")]
    NoReply,
    /// The system refused a socket.
    #[error("the system refused a socket: {0}")]
    System(Errno),
}

/// The address of an instance's socket.
///
/// # Errors
/// `ENAMETOOLONG` when the real path of the runtime directory is much longer than the one that the instance was given.
pub fn address(instance: &Instance) -> Result<UnixAddr, Errno> {
    let runtime = instance.runtime();
    let real = fs::canonicalize(runtime).or_else(|_| std::path::absolute(runtime));
    let runtime = real.unwrap_or_else(|_| runtime.to_owned());
    let name = [PREFIX, instance.name().as_bytes(), b":", runtime.as_os_str().as_bytes()].concat();
    UnixAddr::new_abstract(&name)
}

/// A socket of this kind, not connected yet.
///
/// # Errors
/// Of the system.
pub fn open(flags: SockFlag) -> Result<OwnedFd, Errno> {
    socket(AddressFamily::Unix, SockType::SeqPacket, SockFlag::SOCK_CLOEXEC | flags, None)
}

/// A requested emergency stop.
#[derive(Debug)]
pub struct AskedStop {
    socket: OwnedFd,
    /// Whether the process that listens may be the daemon; an error when its confirmation must not be believed.
    daemon: Result<(), StopError>,
}

impl AskedStop {
    /// Asks the daemon of `instance` to damp and stop every motor. Waits at most `patience` until it is heard.
    ///
    /// # Errors
    /// [`StopError::NotRunning`], [`StopError::NoReply`], [`StopError::System`].
    pub fn send(instance: &Instance, patience: Duration) -> Result<Self, StopError> {
        let address = address(instance).map_err(StopError::System)?;
        let end = Instant::now() + patience;
        loop {
            match Self::try_send(instance, &address, end) {
                // A daemon with too many callers drops the first that have not asked yet: this process may be among them.
                Err(Errno::EPIPE | Errno::ECONNRESET | Errno::EAGAIN | Errno::EINTR)
                    if Instant::now() < end =>
                {
                    std::thread::sleep(RETRY);
                }
                Err(Errno::EPIPE | Errno::ECONNRESET | Errno::EAGAIN | Errno::EINTR) => {
                    return Err(StopError::NoReply);
                }
                Err(Errno::ECONNREFUSED) => return Err(StopError::NotRunning),
                other => return other.map_err(StopError::System),
            }
        }
    }

    fn try_send(instance: &Instance, address: &UnixAddr, end: Instant) -> Result<Self, Errno> {
        let socket = connected(address, end)?;
        send(socket.as_raw_fd(), REQUEST, MsgFlags::MSG_NOSIGNAL)?;
        let daemon = judge(instance, getsockopt(&socket, sockopt::PeerCredentials)?);
        Ok(Self { socket, daemon })
    }

    /// Waits for the confirmation, at most `patience`.
    ///
    /// # Errors
    /// [`StopError::NoReply`] when it may still come; every other one is the last word.
    pub fn confirm(&self, patience: Duration) -> Result<(), StopError> {
        let end = Instant::now() + patience;
        let mut reply = [0; MESSAGE_BYTES_MAX];
        loop {
            wait_at_most(&self.socket, end).map_err(StopError::System)?;
            return match recv(self.socket.as_raw_fd(), &mut reply, MsgFlags::empty()) {
                Ok(length) if reply[..length] == *CONFIRMED => self.daemon,
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

/// No call on `socket` waits beyond `end`, or longer than a millisecond after it.
fn wait_at_most(socket: &OwnedFd, end: Instant) -> Result<(), Errno> {
    let left = end.saturating_duration_since(Instant::now()).max(RETRY);
    let left = TimeVal::new(left.as_secs() as i64, i64::from(left.subsec_micros()));
    setsockopt(socket, sockopt::SendTimeout, &left)?;
    setsockopt(socket, sockopt::ReceiveTimeout, &left)
}

/// Whether the process that listens can be the daemon: of root, of this user, or of a user to whom the runtime directory or the
/// instance's lock belongs.
fn judge(instance: &Instance, peer: UnixCredentials) -> Result<(), StopError> {
    let lock = instance.runtime().join(format!("{}.lock", instance.name()));
    let owner_of = |path: &Path| fs::symlink_metadata(path).ok().map(|found| found.uid());
    let owners = [Some(0), Some(Uid::effective().as_raw()), owner_of(instance.runtime()), owner_of(&lock)];
    if owners.contains(&Some(peer.uid())) {
        Ok(())
    } else {
        Err(StopError::NotTrusted { pid: peer.pid(), uid: peer.uid() })
    }
}

/// A daemon that runs in this network namespace.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct RunningInstance {
    /// The instance's name.
    pub name: String,
    /// Its runtime directory.
    pub runtime: PathBuf,
    /// The daemon's process id; 0 when it lives in another process namespace.
    pub pid: u32,
    /// The daemon's user.
    pub uid: u32,
}

/// The daemons that listen for emergency stops, sorted. Asks nothing of them. Anybody may take a free name: an entry proves no
/// daemon. Its words need no quotes in a shell: an instance has an instance's name, and a directory with other characters than
/// letters, digits and `/._+-` is left out.
#[must_use]
pub fn running() -> Vec<RunningInstance> {
    let table = fs::read("/proc/net/unix").unwrap_or_default();
    let mut running: Vec<_> = table.split(|byte| *byte == b'\n').filter_map(listener).collect();
    running.sort();
    running.dedup();
    running
}

/// The daemon in a line of `/proc/net/unix`, if it is one that listens.
fn listener(line: &[u8]) -> Option<RunningInstance> {
    let start = line.windows(PREFIX.len()).position(|part| part == PREFIX)?;
    let name = line[start..].strip_prefix(PREFIX)?;
    let colon = name.iter().position(|byte| *byte == b':')?;
    let (instance, runtime) = (str::from_utf8(&name[..colon]).ok()?, &name[colon + 1..]);
    let of_a_path = |byte: &u8| byte.is_ascii_alphanumeric() || b"/._+-".contains(byte);
    if !crate::instance::is_name(instance) || !runtime.iter().all(of_a_path) {
        return None;
    }
    let address = UnixAddr::new_abstract(&line[start..]).ok()?;
    let peer = getsockopt(&connected(&address, Instant::now()).ok()?, sockopt::PeerCredentials).ok()?;
    let runtime = PathBuf::from(std::ffi::OsString::from_vec(runtime.to_vec()));
    Some(RunningInstance {
        name: instance.to_owned(),
        runtime,
        pid: peer.pid().cast_unsigned(),
        uid: peer.uid(),
    })
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
        let place = tempfile::tempdir().unwrap();
        let instance = Instance::below(place.path(), "robot").unwrap();
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

    #[test]
    fn instance_is_listed_only_with_listener() {
        let place = tempfile::tempdir().unwrap();
        let instance = Instance::below(place.path(), "robot").unwrap();
        let is_listed = || running().into_iter().find(|found| found.runtime == place.path());
        assert_eq!(AskedStop::send(&instance, Duration::ZERO).map(drop), Err(StopError::NotRunning));
        assert_eq!(is_listed(), None);
        let _daemon = listening(&instance);
        let found = is_listed().unwrap();
        assert_eq!((found.name.as_str(), found.pid), ("robot", std::process::id()));
    }

    #[test]
    fn a_process_of_another_user_is_not_believed() {
        let place = tempfile::tempdir().unwrap();
        let instance = Instance::below(place.path(), "robot").unwrap();
        let of = |uid| UnixCredentials::from(nix::libc::ucred { pid: 7, uid, gid: 0 });
        assert_eq!(judge(&instance, of(0)), Ok(()));
        assert_eq!(judge(&instance, of(Uid::effective().as_raw())), Ok(()));
        assert_eq!(judge(&instance, of(54_321)), Err(StopError::NotTrusted { pid: 7, uid: 54_321 }));
    }
}
