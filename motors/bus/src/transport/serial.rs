//! Serial ports: RS485 and RS232.

use super::access::{Nodes, Transport};
use crate::serial::{Address, Settings};
use crate::time::Duration;

/// RS485 or RS232.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Serial {
    /// The device, `/dev/ttyUSB0`.
    pub device: String,
    /// Bit/s.
    pub baud: u32,
    /// The longest time from the end of a request to the beginning of its reply, the host's adapter
    /// included. The plan uses it.
    pub turnaround: Duration,
}

impl Serial {
    /// Its type in configurations.
    pub const NAME: &'static str = "serial";

    /// Returns the settings of the line with these nodes. A frame names a motor by one byte: a
    /// motor whose id is longer is left out. Allocates.
    fn settings(&self, nodes: &Nodes) -> Settings {
        let addresses = nodes.motors.iter().filter_map(|motor| {
            Some(Address { id: motor.command_id.byte()?, host_id: motor.host_id.byte() })
        });
        Settings {
            device: self.device.clone(),
            baud: self.baud,
            addresses: addresses.collect(),
            reply_timeout: nodes.reply_timeout,
            answers: nodes.answers,
        }
    }
}

impl Transport for Serial {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn bitrate(&self) -> u32 {
        self.baud
    }

    fn turnaround(&self) -> Option<Duration> {
        Some(self.turnaround)
    }

    fn port(&self) -> Option<&str> {
        Some(&self.device)
    }

    fn baud(&self) -> Option<u32> {
        Some(self.baud)
    }

    fn line(&self, nodes: &Nodes) -> Option<Settings> {
        Some(self.settings(nodes))
    }

    #[cfg(feature = "linux")]
    fn hardware(&self) -> Option<&dyn super::access::Hardware> {
        Some(self)
    }
}

#[cfg(feature = "linux")]
mod linux {
    use super::super::access::{Cause, Hardware, Nodes, OpenError, Opened, OpenedAsIs, OpenedSender};
    use super::Serial;
    use crate::serial::{self, SerialBus};
    use crate::time::Duration;
    use crate::{BusLock, Holder, Identity};

    impl Serial {
        /// Returns the port at `address`: a path, which has a slash. A tool plans nothing.
        pub(in super::super) fn at(address: &str, baud: u32) -> Option<Self> {
            let is_path = address.contains('/');
            is_path.then(|| Self { device: address.to_owned(), baud, turnaround: Duration::ZERO })
        }
    }

    impl Hardware for Serial {
        fn lock(&self) -> Result<BusLock, OpenError> {
            Ok(BusLock::device(&self.device)?)
        }

        fn holders(&self, thorough: bool) -> [Option<Holder>; 2] {
            BusLock::holders_of_device(&self.device, thorough)
        }

        /// The port must be closed before it is opened again.
        fn open(&self, nodes: &Nodes, _expected: Option<Identity>) -> Result<Opened, OpenError> {
            Ok(Opened::plain(SerialBus::open(&self.settings(nodes))?))
        }

        fn open_as_is(&self, nodes: &Nodes) -> Result<OpenedAsIs, OpenError> {
            let bus = Box::new(SerialBus::open(&self.settings(nodes))?);
            Ok(OpenedAsIs { bus, bitrate: None, hides_bitrate: false })
        }

        /// Opening and writing have no time limit.
        fn sender(&self, _frames: u32) -> Result<OpenedSender, OpenError> {
            let reason = format!("{}: a serial port needs a thread of its own to send", self.device);
            Err(OpenError::new(Cause::Other, reason))
        }

        /// It is locked, and while it is open, the kernel gives another name to the adapter that is
        /// plugged in again.
        fn closes_before_reopening(&self) -> bool {
            true
        }
    }

    impl From<serial::OpenError> for OpenError {
        fn from(error: serial::OpenError) -> Self {
            use serial::OpenError::{Held, Missing, Permission, Rules};
            let cause = match &error {
                Missing { .. } => Cause::Absent,
                Held { .. } => Cause::Busy,
                Permission { .. } | Rules { .. } => Cause::Forbidden,
                _ => Cause::Other,
            };
            Self::new(cause, error)
        }
    }
}
