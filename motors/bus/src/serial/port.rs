//! A serial port of Linux: raw bytes, 8N1, at any bit rate.
//!
//! - *Exclusive use*: `flock` on the device, which survives a deleted lock file and ends with its
//!   holder. `TIOCEXCL` is not used: it would exclude the dead man's switch, which has a separate
//!   descriptor.
//! - *Latency*: where the driver has such a mode, it delivers bytes without delay.
//! - *Closing*: the kernel waits up to 30 s for bytes that do not leave. This module discards them
//!   after 20 ms.

use super::line::ByteStream;
use super::unit;
use crate::Readiness;
use crate::kernel::{self, errno};
use crate::time::Duration;
use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use rustix::termios::{
    ControlModes, OptionalActions, QueueSelector, SpecialCodeIndex, Termios, tcflush, tcgetattr, tcsetattr,
};
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;

/// Tolerance of the bit rate: the driver rounds a rate that its clock cannot be divided to. 8N1
/// tolerates 2 % on each side.
const BAUD_TOLERANCE: u32 = 50;
/// Time for the last bytes to leave before a port is closed.
const LINGER: Duration = Duration::from_millis(20);

/// Reason for which a port cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum OpenError {
    /// No device has this name.
    #[error(
        "{device}: there is no such device; plug the adapter in (`ls -l /dev/serial/by-id` lists those that are)"
    )]
    Missing {
        /// The device.
        device: String,
    },
    /// The user lacks the permission.
    #[error(
        "{device}: not permitted; add the user to the group of the device (`ls -l {device}`), usually `dialout`"
    )]
    Permission {
        /// The device.
        device: String,
    },
    /// The control group of this process has no rule for the device.
    #[error("{device}: {remedy}")]
    Rules {
        /// The device.
        device: String,
        /// The lines that permit it.
        remedy: String,
    },
    /// A file of another kind.
    #[error("{device} is not a serial port")]
    NotSerial {
        /// The device.
        device: String,
    },
    /// Another process has locked the device.
    #[error("{device} is in use by another process (`fuser {device}` shows which)")]
    Held {
        /// The device.
        device: String,
    },
    /// The driver does not offer the rate.
    #[error(
        "{device} runs at {received} bit/s, {expected} are configured: the adapter does not offer that rate"
    )]
    Baud {
        /// The device.
        device: String,
        /// The configured rate, bit/s.
        expected: u32,
        /// The rate of the port, bit/s.
        received: u32,
    },
    /// A system call failed.
    #[error("{device}: {errno}")]
    System {
        /// The device.
        device: String,
        /// The error of the kernel.
        errno: Errno,
    },
}

/// An open serial port.
#[derive(Debug)]
pub struct Port {
    file: File,
    _lock: Option<Flock<File>>,
}

/// Use of a port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Use {
    /// Exclusive among the processes that lock. Bytes that wait in either direction are discarded.
    Exclusive,
    /// In parallel to its owner.
    Shared,
}

impl Port {
    /// Opens and configures a port. Not for the real-time thread: it allocates, and takes
    /// milliseconds.
    ///
    /// # Errors
    ///
    /// The first error found.
    pub(super) fn open(device: &str, baud: u32, usage: Use) -> Result<Self, OpenError> {
        let failed = |errno| refused(device, errno);
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY)
            .open(device)
            .map_err(|error| failed(errno(&error)))?;
        let current = tcgetattr(&file).map_err(|_| OpenError::NotSerial { device: device.to_owned() })?;
        let lock = match usage {
            Use::Exclusive => Some(lock(device, &file)?),
            Use::Shared => None,
        };
        configure(&file, current, baud).map_err(|error| failed(Errno::from_raw(error.raw_os_error())))?;
        let received = tcgetattr(&file).map_or(0, |termios| termios.output_speed());
        if received.abs_diff(baud) > baud / BAUD_TOLERANCE {
            return Err(OpenError::Baud { device: device.to_owned(), expected: baud, received });
        }
        // A driver without the low-latency mode delivers with its usual delay.
        let _unsupported = kernel::set_low_latency(file.as_fd());
        if usage == Use::Exclusive {
            tcflush(&file, QueueSelector::IOFlush)
                .map_err(|error| failed(Errno::from_raw(error.raw_os_error())))?;
        }
        Ok(Self { file, _lock: lock })
    }

    /// Opens and configures the port of a device that sends by itself, such as an IMU. Exclusive;
    /// bytes that wait are discarded. Allocates, and takes milliseconds.
    ///
    /// # Errors
    ///
    /// The first error found.
    pub fn exclusive(device: &str, baud: u32) -> Result<Self, OpenError> {
        Self::open(device, baud, Use::Exclusive)
    }

    /// Returns `true` when the adapter was unplugged. Never blocks; one system call.
    pub(super) fn is_disconnected(&self) -> bool {
        let mut descriptors = [PollFd::new(self.file.as_fd(), PollFlags::empty())];
        poll(&mut descriptors, PollTimeout::ZERO).is_ok_and(|count| count > 0)
    }
}

/// Each call is one system call.
impl ByteStream for Port {
    fn write(&self, bytes: &[u8]) -> Result<usize, Errno> {
        (&self.file).write(bytes).map_err(|error| errno(&error))
    }

    fn read(&self, buffer: &mut [u8]) -> Result<usize, Errno> {
        (&self.file).read(buffer).map_err(|error| errno(&error))
    }

    fn unsent(&self) -> Result<usize, Errno> {
        kernel::unsent(self.file.as_fd())
    }

    fn readiness(&self) -> Readiness<'_> {
        Readiness::Readable(self.file.as_fd())
    }
}

impl Drop for Port {
    /// Blocks for at most 20 ms.
    fn drop(&mut self) {
        const TURNS: u32 = 20;
        for _ in 0..TURNS {
            if !self.unsent().is_ok_and(|bytes| bytes > 0) {
                return;
            }
            std::thread::sleep(LINGER / TURNS);
        }
        let _disconnected = tcflush(&self.file, QueueSelector::OFlush);
    }
}

/// Configures the port, unless its settings are already correct. A change reaches the adapter, and
/// delays another process's writes meanwhile.
fn configure(file: &File, current: Termios, baud: u32) -> rustix::io::Result<()> {
    let mut wanted = current.clone();
    wanted.make_raw();
    wanted.control_modes |= ControlModes::CREAD | ControlModes::CLOCAL | ControlModes::CS8;
    // Without HUPCL the control lines of an adapter do not change when a process closes it.
    wanted.control_modes -=
        ControlModes::CSTOPB | ControlModes::PARENB | ControlModes::CRTSCTS | ControlModes::HUPCL;
    wanted.special_codes[SpecialCodeIndex::VMIN] = 1;
    wanted.special_codes[SpecialCodeIndex::VTIME] = 0;
    wanted.set_speed(baud)?;
    if is_same(&current, &wanted) { Ok(()) } else { tcsetattr(file, OptionalActions::Now, &wanted) }
}

fn is_same(one: &Termios, other: &Termios) -> bool {
    let modes = |it: &Termios| (it.input_modes, it.output_modes, it.control_modes, it.local_modes);
    let codes =
        |it: &Termios| [SpecialCodeIndex::VMIN, SpecialCodeIndex::VTIME].map(|index| it.special_codes[index]);
    let speeds = |it: &Termios| (it.input_speed(), it.output_speed());
    modes(one) == modes(other) && codes(one) == codes(other) && speeds(one) == speeds(other)
}

fn lock(device: &str, file: &File) -> Result<Flock<File>, OpenError> {
    let own = file.try_clone().map_err(|error| refused(device, errno(&error)))?;
    Flock::lock(own, FlockArg::LockExclusiveNonblock).map_err(|(_, errno)| match errno {
        Errno::EWOULDBLOCK => OpenError::Held { device: device.to_owned() },
        errno => refused(device, errno),
    })
}

fn refused(device: &str, errno: Errno) -> OpenError {
    let device = device.to_owned();
    match errno {
        Errno::ENOENT | Errno::ENODEV | Errno::ENXIO | Errno::EIO => OpenError::Missing { device },
        Errno::EACCES => OpenError::Permission { device },
        Errno::EPERM => OpenError::Rules { remedy: unit::remedy(&device), device },
        Errno::EBUSY => OpenError::Held { device },
        errno => OpenError::System { device, errno },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rule_of_unit_differs_from_permission() {
        let rule = refused("/dev/ttyTHS1", Errno::EPERM);
        assert!(matches!(rule, OpenError::Rules { .. }), "{rule:?}");
        assert!(!rule.to_string().contains("dialout"), "{rule}");
        let permission = refused("/dev/ttyTHS1", Errno::EACCES).to_string();
        assert!(permission.contains("dialout"), "{permission}");
    }
}
