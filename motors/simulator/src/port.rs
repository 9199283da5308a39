//! Simulated motors on a pseudo terminal, for a host in another process.

use crate::{Fault, FaultVerb, InjectError, SerialSlave, SimulatedBus};
use motord_bus::{Instant, Readiness};
use nix::errno::Errno;
use nix::fcntl::{FcntlArg, FdFlag, OFlag, fcntl};
use nix::pty::openpty;
use nix::sys::termios::{FlowArg, tcflow};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};

/// Most bytes that one call of [`SerialPort::serve`] reads.
const BYTES_MAX: usize = 4096;

/// The motors of a [`SerialSlave`] on a pseudo terminal. A host may open and close it repeatedly:
/// its settings and the motors persist.
///
/// Faults of the port, in addition to those of the line: [`Fault::Gone`] unplugs it, so that the
/// host's descriptor hangs up. [`Fault::Blocked`] makes it refuse the host's bytes. [`Fault::Ok`]
/// ends both; the pseudo terminal may then have another name.
#[derive(Debug)]
pub struct SerialPort {
    slave: SerialSlave,
    terminal: Option<Terminal>,
    /// A symbolic link that always refers to the pseudo terminal.
    link: Option<PathBuf>,
    answers: Vec<u8>,
}

/// Bit/s of a line of motors (GIM document, Table 1). Another one of the host has no effect.
const BAUD: u32 = 921_600;

impl SerialPort {
    /// Opens a pseudo terminal for the motors of `slave`. `link` becomes a symbolic link to it. It
    /// may replace an older symbolic link, but no other file.
    ///
    /// # Errors
    ///
    /// The kernel provides no pseudo terminal, or the link cannot be created.
    pub fn open(slave: SerialSlave, link: Option<PathBuf>) -> Result<Self, std::io::Error> {
        let mut port = Self { slave, terminal: None, link, answers: Vec::new() };
        port.plug()?;
        Ok(port)
    }

    /// Returns the device that the host opens; `None` while it is unplugged.
    #[must_use]
    pub fn path(&self) -> Option<&Path> {
        self.terminal.as_ref().map(Terminal::path)
    }

    /// Returns the motors.
    pub fn bus(&mut self) -> &mut SimulatedBus {
        self.slave.bus()
    }

    /// Returns the name that fault verbs use for it.
    #[must_use]
    pub fn name(&self) -> &str {
        self.slave.name()
    }

    /// Transfers the bytes that have arrived by `now`, in both directions. Answers that the host
    /// does not read in time are lost, as in a full buffer.
    pub fn serve(&mut self, now: Instant) {
        let mut received = [0; BYTES_MAX];
        let count = self.terminal.as_ref().map_or(0, |terminal| terminal.read(&mut received));
        self.answers.clear();
        self.slave.transact(now, &received[..count], &mut self.answers);
        if let Some(terminal) = &self.terminal
            && !self.answers.is_empty()
        {
            terminal.write(&self.answers);
        }
    }

    /// Returns the descriptor that becomes readable when bytes arrive.
    #[must_use]
    pub fn readiness(&self) -> Readiness<'_> {
        let readable = |terminal| Readiness::Readable(Terminal::device_end(terminal));
        self.terminal.as_ref().map_or(Readiness::Never, readable)
    }

    /// Returns the earliest time of an answer, if no byte arrives before.
    #[must_use]
    pub fn due(&self) -> Instant {
        match self.slave.readiness() {
            Readiness::At(instant) => instant,
            Readiness::Readable(_) | Readiness::Never => Instant::FAR_FUTURE,
        }
    }

    /// Applies `verb` to the port, to its bus or to one of its motors.
    ///
    /// # Errors
    ///
    /// As for [`SimulatedBus::inject`], and when the kernel refuses a system call that the fault
    /// needs.
    pub fn inject(&mut self, now: Instant, verb: &FaultVerb) -> Result<(), InjectError> {
        if verb.target != self.name() {
            return self.slave.inject(now, verb);
        }
        match verb.fault {
            Fault::Gone => self.unplug(),
            Fault::Blocked => self.flow(FlowArg::TCOOFF)?,
            Fault::Ok => {
                if self.terminal.is_none() {
                    self.plug().map_err(|error| InjectError::Unplugged(error.raw_os_error().unwrap_or(0)))?;
                }
                self.flow(FlowArg::TCOON)?;
                self.slave.inject(now, verb)?;
            }
            _ => self.slave.inject(now, verb)?,
        }
        Ok(())
    }

    fn flow(&self, flow: FlowArg) -> Result<(), InjectError> {
        let Some(terminal) = &self.terminal else { return Err(InjectError::Unplugged(Errno::ENODEV as i32)) };
        terminal.flow(flow).map_err(|errno| InjectError::Unplugged(errno as i32))
    }

    /// Removes the terminal and the link: the kernel may give the terminal's name to another one.
    fn unplug(&mut self) {
        self.terminal = None;
        let _already_removed = self.link.as_ref().map(std::fs::remove_file);
    }

    fn plug(&mut self) -> Result<(), std::io::Error> {
        self.terminal = Some(Terminal::open(self.link.as_deref(), BAUD)?);
        Ok(())
    }
}

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
