//! The identity of a bus under all its names.

use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

use nix::net::if_::{if_indextoname, if_nametoindex};
use nix::sys::stat::{major, minor};

/// Major device numbers of pseudo terminals. Each mounted `devpts` counts them from 0.
const PSEUDO_TERMINALS: core::ops::RangeInclusive<u64> = 136..=143;

/// A CAN interface or a serial port. Two names of one bus, such as `can0` and an alternative name
/// of it, have one identity. It holds until the adapter is unplugged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Identity {
    /// The index of an interface in the network namespace of this process.
    Interface(u32),
    /// A character device.
    Device {
        /// Its device number.
        number: u64,
        /// For a pseudo terminal, the file system that has it.
        terminals: Option<u64>,
    },
}

impl Identity {
    /// Returns the interface that has the name or alternative name `name` now; `None` without one.
    /// Three system calls.
    #[must_use]
    pub fn of_interface(name: &str) -> Option<Self> {
        if_nametoindex(name).ok().map(Self::Interface)
    }

    /// Returns the index of an interface; `None` for a device.
    #[must_use]
    pub const fn interface(self) -> Option<u32> {
        match self {
            Self::Interface(index) => Some(index),
            Self::Device { .. } => None,
        }
    }

    /// Returns the folder in which sysfs shows it. One system call.
    pub(crate) fn folder(self) -> PathBuf {
        match self {
            Self::Interface(index) => {
                let name = if_indextoname(index).ok();
                let name = name.and_then(|name| name.into_string().ok()).unwrap_or_default();
                Path::new("/sys/class/net").join(name)
            }
            Self::Device { number, .. } => {
                format!("/sys/dev/char/{}:{}", major(number), minor(number)).into()
            }
        }
    }

    /// Returns the character device at `path`, through symbolic links; `None` without one. One
    /// system call.
    #[must_use]
    pub fn of_device(path: &str) -> Option<Self> {
        let file = std::fs::metadata(path).ok().filter(|file| file.file_type().is_char_device())?;
        let is_terminal = PSEUDO_TERMINALS.contains(&major(file.rdev()));
        Some(Self::Device { number: file.rdev(), terminals: is_terminal.then(|| file.dev()) })
    }
}
