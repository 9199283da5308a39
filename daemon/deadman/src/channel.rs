//! The connection between a daemon and its dead man's switch: a socket for messages, and one file
//! with the first.
//!
//! The socket is `<runtime>/<instance>.deadman`. Only processes of the same user, or of root, get
//! an answer: a process that registers decides which frames are sent. The caller trusts only root,
//! the same user and the owner of the runtime directory: every member may bind a free name there,
//! and a false switch would leave the motors running.

use crate::heartbeat::Pulse;
use crate::kernel::adopt;
use motord_bus::Duration;
use motord_ports::instance::{Instance, InstanceError};
use motord_ports::{RoleLock, peer};
use nix::cmsg_space;
use nix::errno::Errno;
use nix::sys::socket::{
    AddressFamily, Backlog, ControlMessage, ControlMessageOwned, MsgFlags, SockFlag, SockType, UnixAddr,
    accept4, bind, connect, getsockopt, listen, recv, recvmsg, send, sendmsg, setsockopt, socket, sockopt,
};
use nix::sys::time::TimeVal;
use nix::unistd::geteuid;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::io::{self, IoSlice, IoSliceMut};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd, RawFd};
use std::path::PathBuf;

use crate::safe_frames::{InterfaceError, SafeFrames};

/// Most bytes of a message: the safe frames of 64 motors have about 8 000.
const MESSAGE_BYTES_MAX: usize = 32 * 1024;
/// Most files that Linux passes with one message, `SCM_MAX_FD`. With space for fewer, those that
/// fit would stay open without a known number.
const FILES_MAX: usize = 253;
/// Longest time of one wait for the switch, which opens an interface in milliseconds. A daemon that
/// registers waits again.
pub const TIMEOUT: Duration = Duration::from_secs(2);
/// Prefix of every message. Its number rises with every change of the messages, so that a program
/// of another version is refused with an error that names the reason.
const VERSION: &[u8] = b"motord-deadman 4\n";
/// The message by which the switch shows that it runs.
const BEAT: &[u8] = b".";
/// Most signs of life per read.
const BEATS_MAX: usize = 256;

const OTHER_VERSION: &str = "daemon and dead man's switch are of different versions: restart both";

/// A request to the switch.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Request {
    /// Asks the switch to supervise the sender, and to send these frames when the sender cannot.
    /// Carries the file of the heartbeat.
    Register(SafeFrames),
    /// Asks which interfaces the switch has still to serve.
    AskWhetherActing,
}

/// The answer of the switch.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Answer {
    /// The daemon is supervised.
    Registered,
    /// The daemon is not supervised.
    Refused(Refusal),
    /// The interfaces whose motors it has still to damp or stop; none when it does not act.
    Acting(Vec<String>),
}

/// Why a registration is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error, Serialize, Deserialize)]
pub enum Refusal {
    /// It supervises another process that lives.
    #[error("it supervises process {pid}, which lives")]
    Busy {
        /// That process.
        pid: i32,
    },
    /// The heartbeat is missing or at rest: no cycle runs.
    #[error("the heartbeat is missing or at rest")]
    NoHeartbeat,
    /// The motors of an interface could not be stopped.
    #[error("{0}")]
    SafeFrames(InterfaceError),
    /// The message is no request, or one of another version.
    #[error("{reason}")]
    Request {
        /// The error, as text: it comes from another process.
        reason: String,
    },
}

/// One end of a connection.
#[derive(Debug)]
pub struct Channel(OwnedFd);

impl Channel {
    /// Connects to the switch of an instance. Each wait for it lasts at most `timeout`.
    ///
    /// # Errors
    ///
    /// `NotFound` or `ConnectionRefused` when there is none; a [`Impostor`](motord_ports::Impostor)
    /// when a process of another user listens instead: nothing was sent to it.
    pub fn connect(instance: &Instance, timeout: Duration) -> io::Result<Self> {
        let socket = open(SockFlag::empty())?;
        let micros = i64::from(timeout.subsec_micros());
        let timeout = TimeVal::new(timeout.as_secs().cast_signed(), micros);
        setsockopt(&socket, sockopt::SendTimeout, &timeout)?;
        setsockopt(&socket, sockopt::ReceiveTimeout, &timeout)?;
        connect(socket.as_raw_fd(), &address(instance)?)?;
        peer::check(instance, &socket)?;
        Ok(Self(socket))
    }

    /// Sends `message`, and the file behind `pulse` with it.
    ///
    /// # Errors
    ///
    /// `BrokenPipe` when the other end is closed, `WouldBlock` when it does not read.
    pub fn send(&self, message: &impl Serialize, pulse: Option<&Pulse>) -> io::Result<()> {
        let text = [VERSION, &serde_json::to_vec(message)?].concat();
        let files: Vec<RawFd> = pulse.iter().map(|pulse| pulse.as_fd().as_raw_fd()).collect();
        let control = [ControlMessage::ScmRights(&files)];
        let control = if files.is_empty() { &[][..] } else { &control };
        let flags = MsgFlags::MSG_NOSIGNAL;
        sendmsg::<()>(self.0.as_raw_fd(), &[IoSlice::new(&text)], control, flags, None)?;
        Ok(())
    }

    /// Returns the next message, and the first file that arrived with it.
    ///
    /// # Errors
    ///
    /// `UnexpectedEof` when the other end is closed, `InvalidData` for any other message and one of
    /// another version, `WouldBlock` when none has arrived.
    pub fn receive<T: DeserializeOwned>(&self) -> io::Result<(T, Option<Pulse>)> {
        let mut text = vec![0; MESSAGE_BYTES_MAX];
        let mut control = cmsg_space!([RawFd; FILES_MAX]);
        let (bytes, whole, files) = {
            let mut buffer = [IoSliceMut::new(&mut text)];
            let flags = MsgFlags::MSG_CMSG_CLOEXEC;
            let message = recvmsg::<()>(self.0.as_raw_fd(), &mut buffer, Some(&mut control), flags)?;
            let files: Vec<OwnedFd> = message.cmsgs()?.flat_map(files_in).collect();
            (message.bytes, !message.flags.contains(MsgFlags::MSG_TRUNC), files)
        };
        if bytes == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        let Some(text) = text[..bytes].strip_prefix(VERSION).filter(|_| whole) else {
            return Err(io::Error::new(io::ErrorKind::InvalidData, OTHER_VERSION));
        };
        Ok((serde_json::from_slice(text)?, files.into_iter().next().map(Pulse::from)))
    }

    /// Returns true when the other end is closed, or has sent an unexpected message. Neither
    /// allocates nor blocks; one system call.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        recv(self.0.as_raw_fd(), &mut [0], MsgFlags::MSG_DONTWAIT) != Err(Errno::EAGAIN)
    }

    /// Sends the other end a sign of life. Neither allocates nor blocks; one system call. An unread
    /// one is no error.
    pub fn beat(&self) {
        let _full_or_ended = send(self.0.as_raw_fd(), BEAT, MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_NOSIGNAL);
    }

    /// Reads the signs of life that have arrived. Returns true when there was one, and `None` when
    /// the other end is closed. Neither allocates nor blocks.
    #[must_use]
    pub fn take_beats(&self) -> Option<bool> {
        for taken in 0..BEATS_MAX {
            match recv(self.0.as_raw_fd(), &mut [0], MsgFlags::MSG_DONTWAIT) {
                Ok(0) => return None,
                Ok(_) => {}
                Err(Errno::EAGAIN) => return Some(taken > 0),
                Err(_) => return None,
            }
        }
        Some(true)
    }

    /// Returns the process at the other end; `None` when it belongs to another user.
    #[must_use]
    pub fn peer(&self) -> Option<i32> {
        let peer = getsockopt(&self.0, sockopt::PeerCredentials).ok()?;
        (peer.uid() == 0 || peer.uid() == geteuid().as_raw()).then(|| peer.pid())
    }
}

impl AsFd for Channel {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

fn files_in(message: ControlMessageOwned) -> Vec<OwnedFd> {
    match message {
        ControlMessageOwned::ScmRights(files) => files.into_iter().map(adopt).collect(),
        _ => Vec::new(),
    }
}

/// Why a process is not the switch of an instance.
#[derive(Debug, thiserror::Error)]
pub enum BindError {
    /// The lock or the directory.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// The socket.
    #[error("the system refused a socket: {0}")]
    System(#[from] Errno),
}

/// The socket on which the switch of an instance accepts connections.
#[derive(Debug)]
pub struct Listener {
    socket: OwnedFd,
    _lock: RoleLock,
}

impl Listener {
    /// Claims the role of the switch of an instance, until the value is dropped or the process
    /// dies. Logs what another user had put in its place.
    ///
    /// # Errors
    ///
    /// [`BindError::Instance`] when another process has it, or the runtime directory does not exist
    /// or belongs to another user; [`BindError::System`] without a socket.
    pub fn bind(instance: &Instance) -> Result<Self, BindError> {
        let lock = RoleLock::claim(instance, "deadman")?;
        lock.displaced().iter().for_each(|displaced| tracing::warn!("{displaced}"));
        let socket = open(SockFlag::SOCK_NONBLOCK)?;
        bind(socket.as_raw_fd(), &address(instance)?)?;
        listen(&socket, Backlog::new(8)?)?;
        Ok(Self { socket, _lock: lock })
    }

    /// Accepts the next connection.
    ///
    /// # Errors
    ///
    /// `WouldBlock` when there is none, others when no descriptors are left.
    pub fn accept(&self) -> io::Result<Channel> {
        let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
        Ok(Channel(adopt(accept4(self.socket.as_raw_fd(), flags)?)))
    }
}

impl AsFd for Listener {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

fn open(flags: SockFlag) -> nix::Result<OwnedFd> {
    socket(AddressFamily::Unix, SockType::SeqPacket, SockFlag::SOCK_CLOEXEC | flags, None)
}

fn address(instance: &Instance) -> nix::Result<UnixAddr> {
    UnixAddr::new(&path_of(instance))
}

fn path_of(instance: &Instance) -> PathBuf {
    instance.runtime().join(format!("{}.deadman", instance.name()))
}
