//! The users whose processes may answer for motord on a local socket, and hold its locks.

use crate::instance::{Instance, SERVICE_RUNTIME};
use nix::sys::socket::{UnixCredentials, getsockopt, sockopt};
use nix::unistd::Uid;
use std::fmt::{self, Display, Formatter};
use std::fs;
use std::io;
use std::os::fd::AsFd;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// A process that answers on a socket of motord, and whose user is not trusted with that.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Impostor {
    /// Its process id; 0 when it lives in another process namespace.
    pub pid: i32,
    /// Its user.
    pub uid: u32,
}

impl std::error::Error for Impostor {}

/// Reads the program's name from `/proc`: it may be that of a later process with the same id.
impl Display for Impostor {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { pid, uid } = self;
        let program = program(pid).map(|program| format!(" ({program})")).unwrap_or_default();
        write!(
            f,
            "process {pid}{program} of user {uid} answers instead of motord: end that process, `sudo kill {pid}`"
        )
    }
}

/// Returns the name of the program of process `pid`. The process chooses it, so other characters
/// than printable ASCII are omitted.
#[must_use]
pub fn program(pid: impl Display) -> Option<String> {
    let name = fs::read(format!("/proc/{pid}/comm")).ok()?;
    let name: String =
        name.iter().filter(|byte| (b' '..=b'~').contains(byte)).map(|byte| *byte as char).collect();
    (!name.is_empty()).then_some(name)
}

/// Users whose processes count as motord for this process, wherever their daemon runs.
///
/// They are root, this user, the user who became root by `sudo` for this process, and the owner of
/// `/run/motord`, as whom the service runs. Only root can create that directory.
#[derive(Debug, Clone)]
pub struct TrustedUsers(Vec<u32>);

impl TrustedUsers {
    /// Finds them.
    #[must_use]
    pub fn find() -> Self {
        let mut users = vec![0, Uid::effective().as_raw()];
        if Uid::effective().is_root() {
            users.extend(std::env::var("SUDO_UID").ok().and_then(|uid| uid.parse::<u32>().ok()));
        }
        users.extend(owner(Path::new(SERVICE_RUNTIME)));
        Self(users)
    }

    /// Adds the owner of the runtime directory of `instance`, which this process was told to use. A
    /// directory that must belong to this user adds no user: another one may create it at any time.
    #[must_use]
    pub fn and_of(mut self, instance: &Instance) -> Self {
        self.0.extend(owner_of(instance));
        self
    }

    /// Returns true for one of them.
    #[must_use]
    pub fn contains(&self, uid: u32) -> bool {
        self.0.contains(&uid)
    }
}

/// Returns the owner of the runtime directory of `instance`. `None` for one that must belong to
/// this user: another user may create it at any time while it is missing, and its owner is not
/// asked.
fn owner_of(instance: &Instance) -> Option<u32> {
    (!instance.is_private()).then(|| owner(instance.runtime())).flatten()
}

fn owner(directory: &Path) -> Option<u32> {
    fs::metadata(directory).ok().map(|found| found.uid())
}

/// Checks that the process at the other end of `socket`, a connected Unix socket, belongs to root,
/// to this user, or to the owner of a runtime directory that several users share. Every member of
/// the group may bind a free name in that directory. One system call, and one for a process of
/// another user.
///
/// # Errors
/// A [`Impostor`], as an error of the kind `PermissionDenied`; those of the system.
pub fn check(instance: &Instance, socket: &impl AsFd) -> io::Result<()> {
    check_peer(instance, getsockopt(socket, sockopt::PeerCredentials)?)
        .map_err(|impostor| io::Error::new(io::ErrorKind::PermissionDenied, impostor))
}

/// Works like [`check`], for the credentials of the other process.
///
/// # Errors
/// The [`Impostor`].
pub(crate) fn check_peer(instance: &Instance, peer: UnixCredentials) -> Result<(), Impostor> {
    if [0, Uid::effective().as_raw()].contains(&peer.uid()) {
        return Ok(());
    }
    if owner_of(instance) == Some(peer.uid()) {
        Ok(())
    } else {
        Err(Impostor { pid: peer.pid(), uid: peer.uid() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stop_socket::{StopError, StopPath};
    use std::os::unix::fs::{chown, lchown};

    const OUTSIDER: u32 = 54_321;

    /// Goal: a user who creates the missing private directory of another one does not answer for
    /// motord, and confirms no emergency stop. Method: the directory and the lock in it belong to
    /// that user; only root can give them away.
    #[test]
    fn owner_of_foreign_private_directory_is_impostor() {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        let shared = Instance::below(directory.path(), "robot").unwrap();
        let private = shared.clone().made_private();
        fs::write(shared.lock_path(), "").unwrap();
        let is_given = chown(directory.path(), Some(OUTSIDER), None).is_ok();
        let is_given = is_given && lchown(shared.lock_path(), Some(OUTSIDER), None).is_ok();
        let outsider = UnixCredentials::from(nix::libc::ucred { pid: 7, uid: OUTSIDER, gid: 0 });
        let impostor = Impostor { pid: 7, uid: OUTSIDER };
        assert_eq!(check_peer(&private, outsider), Err(impostor));
        let checked = |instance| StopPath::of(instance).unwrap().check_peer(outsider);
        assert_eq!(checked(&private), Err(StopError::NotTrusted(impostor)));
        assert!(!TrustedUsers::find().and_of(&private).contains(OUTSIDER));
        assert_eq!((check_peer(&shared, outsider).is_ok(), checked(&shared).is_ok()), (is_given, is_given));
    }
}
