//! Reasons why an instance cannot be used.

use crate::permission::advice;
use motord_shared::limits::NAME_BYTES_MAX;
use nix::errno::Errno;
use std::path::{Path, PathBuf};

/// Environment variable that names another runtime directory.
pub const RUNTIME_DIR_VARIABLE: &str = "MOTORD_RUNTIME_DIR";

/// Limit on the bytes of an instance's root path. Its sockets lie below it: a socket's path holds
/// 107 bytes, and `/m_<number of up to 39 digits>.event` takes 48 of them.
pub(crate) const ROOT_BYTES_MAX: usize = 107 - 48;

/// The reason why an instance cannot be reached or locked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum InstanceError {
    /// The name is invalid.
    #[error("{name:?} is no instance name: use 1 to {NAME_BYTES_MAX} of the characters a-z, 0-9 and -")]
    Name {
        /// The name.
        name: String,
    },
    /// The user may not enter the runtime directory.
    #[error(
        "permission denied for {}: {}, or name another directory in {RUNTIME_DIR_VARIABLE}",
        path.display(),
        advice(path)
    )]
    Permission {
        /// The inaccessible directory.
        path: PathBuf,
    },
    /// Another user created, or can enter, a directory that must be private.
    #[error(
        "{} must be a directory of user {uid} that no other user can enter: remove it, or name another directory in \
         {RUNTIME_DIR_VARIABLE}",
        path.display()
    )]
    NotPrivate {
        /// The directory.
        path: PathBuf,
        /// The required owner.
        uid: u32,
    },
    /// The paths of the sockets would be too long for the system.
    #[error(
        "{} is too long, an instance's path may have {ROOT_BYTES_MAX} bytes: name a shorter directory in \
         {RUNTIME_DIR_VARIABLE}",
        path.display()
    )]
    PathLength {
        /// The instance's path.
        path: PathBuf,
    },
    /// iceoryx2 and its sockets do not support this path.
    #[error(
        "{path:?} has a character outside ASCII, or one of < > \" | ? * and the backslash: name another directory in \
         {RUNTIME_DIR_VARIABLE}"
    )]
    Characters {
        /// The runtime directory.
        path: PathBuf,
    },
    /// The path names a file or a link instead of a directory.
    #[error("{} is no directory: remove it, or name another directory in {RUNTIME_DIR_VARIABLE}", path.display())]
    NotDirectory {
        /// The file or link.
        path: PathBuf,
    },
    /// Another user created a directory of the daemon.
    #[error(
        "{} belongs to user {owner}, who could change its contents: remove it, or name another directory in \
         {RUNTIME_DIR_VARIABLE}",
        path.display()
    )]
    NotOurs {
        /// The directory.
        path: PathBuf,
        /// Its owner.
        owner: u32,
    },
    /// Another daemon holds the instance.
    #[error("process {pid} already runs this instance: stop it first, or run another instance ({})", path.display())]
    AlreadyRunning {
        /// The holder; 0 before it wrote its process id.
        pid: u32,
        /// The daemon's lock.
        path: PathBuf,
    },
    /// A process keeps clients out by a lock on the instance's directory.
    #[error("process {pid} keeps every client out, by a lock on {}: end that process", path.display())]
    Locked {
        /// The directory.
        path: PathBuf,
        /// The process.
        pid: u32,
    },
    /// Another error of the system.
    #[error("cannot use {}: {errno}", path.display())]
    System {
        /// The file or directory.
        path: PathBuf,
        /// The error.
        errno: Errno,
    },
}

impl InstanceError {
    /// Returns `true` if the name or the directory cannot be used by any process.
    #[must_use]
    pub const fn is_a_setting(&self) -> bool {
        matches!(self, Self::Name { .. } | Self::PathLength { .. } | Self::Characters { .. })
    }
}

/// Returns the error of the kernel for `path`.
pub(crate) fn refused(path: &Path, errno: Errno) -> InstanceError {
    let path = path.to_owned();
    match errno {
        Errno::EACCES | Errno::EPERM => InstanceError::Permission { path },
        errno => InstanceError::System { path, errno },
    }
}
