//! A pseudo terminal: the simulated device has one end, and a host in another process the other.

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, FdFlag, OFlag, fcntl};
use nix::pty::openpty;
use nix::sys::termios::{FlowArg, tcflow};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};

/// An open pseudo terminal. Dropping it hangs up the host's descriptor.
#[derive(Debug)]
pub(crate) struct Terminal {
    device_end: OwnedFd,
    /// Kept open: without it, the device's end would hang up whenever the host closes its own.
    host_end: OwnedFd,
    path: PathBuf,
}

impl Terminal {
    /// Opens a terminal in raw mode, in which the kernel interprets no byte. `link` becomes a
    /// symbolic link to it. It may replace an older symbolic link, but no other file. It has `baud`
    /// until a host sets another one.
    pub(crate) fn open(link: Option<&Path>, baud: u32) -> Result<Self, std::io::Error> {
        let ends = openpty(None, None)?;
        // A child of this process would keep the terminal from hanging up.
        for end in [&ends.master, &ends.slave] {
            fcntl(end, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC))?;
        }
        let mut settings = tcgetattr(&ends.slave)?;
        settings.make_raw();
        settings.set_speed(baud)?;
        tcsetattr(&ends.slave, OptionalActions::Now, &settings)?;
        fcntl(&ends.master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK))?;
        let path = nix::unistd::ttyname(&ends.slave)?;
        if let Some(link) = link {
            relink(link, &path)?;
        }
        Ok(Self { device_end: ends.master, host_end: ends.slave, path })
    }

    /// Returns the device that the host opens.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the descriptor that becomes readable when the host has written.
    pub(crate) fn device_end(&self) -> BorrowedFd<'_> {
        self.device_end.as_fd()
    }

    /// Returns the baud rate that the host has set.
    pub(crate) fn speed(&self) -> Option<u32> {
        Some(tcgetattr(&self.host_end).ok()?.output_speed())
    }

    /// Reads the bytes of the host, and returns their number. Never blocks.
    pub(crate) fn read(&self, buffer: &mut [u8]) -> usize {
        nix::unistd::read(&self.device_end, buffer).unwrap_or(0)
    }

    /// Writes bytes to the host. Those that it does not read in time are lost, as in a full buffer.
    pub(crate) fn write(&self, bytes: &[u8]) {
        let _lost = nix::unistd::write(&self.device_end, bytes);
    }

    /// Blocks or passes the bytes of the host.
    pub(crate) fn flow(&self, flow: FlowArg) -> Result<(), Errno> {
        tcflow(&self.host_end, flow)
    }
}

/// Replaces the link. Refuses to replace any other file, which could be the device of a real
/// adapter.
fn relink(link: &Path, to: &Path) -> Result<(), std::io::Error> {
    if link.symlink_metadata().is_ok_and(|metadata| metadata.is_symlink()) {
        std::fs::remove_file(link)?;
    }
    std::os::unix::fs::symlink(to, link)
}
