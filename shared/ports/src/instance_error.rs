//! Why an instance cannot be used.

use crate::permission::advice;
use motord_shared::limits::NAME_BYTES_MAX;
use nix::errno::Errno;
use std::path::{Path, PathBuf};

/// The variable that names another runtime directory.
pub const RUNTIME_DIR_VARIABLE: &str = "MOTORD_RUNTIME_DIR";

/// Most bytes of an instance's root path. Its sockets lie below it: a socket's path holds 107 bytes, and
/// `/m_<number of up to 39 digits>.event` takes 48 of them.
pub(crate) const ROOT_BYTES_MAX: usize = 107 - 48;

/// Why an instance cannot be reached or held.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum InstanceError {
    /// The name has a form that no instance has.
    #[error("{name:?} is no instance name: use 1 to {NAME_BYTES_MAX} of the characters a-z, 0-9 and -")]
    Name {
        /// The name that was given.
        name: String,
    },
    /// The user may not enter the runtime directory.
    #[error(
        "permission denied for {}: {}, or name another directory in {RUNTIME_DIR_VARIABLE}",
        path.display(),
        advice(path)
    )]
    Permission {
        /// The directory that could not be entered.
        path: PathBuf,
    },
    /// Someone else prepared, or could enter, a directory that must be private.
    #[error(
        "{} must be a directory of user {uid} that nobody else can enter: remove it, or name another directory in \
         {RUNTIME_DIR_VARIABLE}",
        path.display()
    )]
    NotPrivate {
        /// The directory.
        path: PathBuf,
        /// Who should own it.
        uid: u32,
    },
    /// The sockets would get paths that are too long for the system.
    #[error(
        "{} is too long, an instance's path may have {ROOT_BYTES_MAX} bytes: name a shorter directory in \
         {RUNTIME_DIR_VARIABLE}",
        path.display()
    )]
    PathLength {
        /// The instance's path.
        path: PathBuf,
    },
    /// iceoryx2 and its sockets take no such path.
    #[error(
        "{path:?} has a character outside ASCII, or one of < > \" | ? * and the backslash: name another directory in \
         {RUNTIME_DIR_VARIABLE}"
    )]
    Characters {
        /// The runtime directory.
        path: PathBuf,
    },
    /// A file or a link lies where a directory should.
    #[error("{} is no directory: remove it, or name another directory in {RUNTIME_DIR_VARIABLE}", path.display())]
    NotDirectory {
        /// The file or link.
        path: PathBuf,
    },
    /// Another user created a directory of the daemon.
    #[error(
        "{} belongs to user {owner}, who could change what lies in it: remove it, or name another directory in \
         {RUNTIME_DIR_VARIABLE}",
        path.display()
    )]
    NotOurs {
        /// The directory.
        path: PathBuf,
        /// Whose it is.
        owner: u32,
    },
    /// Another daemon holds the instance.
    #[error("process {pid} already runs this instance: stop it first, or run another instance ({})", path.display())]
    AlreadyRunning {
        /// The holder; 0 before it wrote its process id.
        pid: u32,
        /// The lock that it holds.
        path: PathBuf,
    },
    /// The system refused something else.
    #[error("cannot use {}: {errno}", path.display())]
    System {
        /// The file or directory.
        path: PathBuf,
        /// Why.
        errno: Errno,
    },
}

impl InstanceError {
    /// No process can use the name or the directory.
    #[must_use]
    pub const fn is_a_setting(&self) -> bool {
        matches!(self, Self::Name { .. } | Self::PathLength { .. } | Self::Characters { .. })
    }
}

/// The error of the kernel about `path`.
pub(crate) fn refused(path: &Path, errno: Errno) -> InstanceError {
    let path = path.to_owned();
    match errno {
        Errno::EACCES | Errno::EPERM => InstanceError::Permission { path },
        errno => InstanceError::System { path, errno },
    }
}
