//! The users whose processes may answer for motord on a local socket.

use crate::instance::Instance;
use nix::sys::socket::{UnixCredentials, getsockopt, sockopt};
use nix::unistd::Uid;
use std::fs;
use std::io;
use std::os::fd::AsFd;
use std::os::unix::fs::MetadataExt;

/// A process that answers on a socket of motord, and whose user is not trusted with that.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("process {pid} of user {uid} answers instead of motord: end that process")]
pub struct Impostor {
    /// Its process id; 0 when it lives in another process namespace.
    pub pid: i32,
    /// Its user.
    pub uid: u32,
}

/// Checks that the process at the other end of `socket`, a connected Unix socket, belongs to root,
/// to this user, or to the owner of the runtime directory. Every member of the group may bind a
/// free name in that directory. One system call, and one for a process of another user.
///
/// # Errors
/// A [`Impostor`], as an error of the kind `PermissionDenied`; those of the system.
pub fn check(instance: &Instance, socket: &impl AsFd) -> io::Result<()> {
    judge(instance, getsockopt(socket, sockopt::PeerCredentials)?)
        .map_err(|impostor| io::Error::new(io::ErrorKind::PermissionDenied, impostor))
}

/// Works like [`check`], for the credentials of the other process.
///
/// # Errors
/// The [`Impostor`].
pub(crate) fn judge(instance: &Instance, peer: UnixCredentials) -> Result<(), Impostor> {
    if [0, Uid::effective().as_raw()].contains(&peer.uid()) {
        return Ok(());
    }
    let owner = fs::metadata(instance.runtime()).ok().map(|found| found.uid());
    if owner == Some(peer.uid()) { Ok(()) } else { Err(Impostor { pid: peer.pid(), uid: peer.uid() }) }
}
