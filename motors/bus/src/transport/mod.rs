//! Transports: the ways from this computer to the motors of a bus.
//!
//! One file has all that motord knows about a transport: its name in configurations, its place in
//! the plan, its lock, and the ways it is opened. Other code asks a [`BusKind`], and does not
//! match on it.

mod access;
mod serial;
mod socketcan;

#[cfg(feature = "linux")]
pub use access::{
    Cause, Hardware, MotorsBus, MotorsEnd, OpenError, Opened, OpenedAsIs, OpenedSender, SendingBus,
};
pub use access::{Node, Nodes, Transport};
pub use serial::Serial;
pub use socketcan::SocketCan;

use core::ops::Deref;

/// A bus as it is configured: its transport, with the settings of that.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum BusKind {
    /// A CAN interface of Linux.
    SocketCan(SocketCan),
    /// RS485 or RS232.
    Serial(Serial),
    /// Simulated motors inside the daemon.
    Simulated(Simulated),
}

impl Deref for BusKind {
    type Target = dyn Transport;

    fn deref(&self) -> &Self::Target {
        match self {
            Self::SocketCan(transport) => transport,
            Self::Serial(transport) => transport,
            Self::Simulated(transport) => transport,
        }
    }
}

impl From<SocketCan> for BusKind {
    fn from(transport: SocketCan) -> Self {
        Self::SocketCan(transport)
    }
}

impl From<Serial> for BusKind {
    fn from(transport: Serial) -> Self {
        Self::Serial(transport)
    }
}

impl From<Simulated> for BusKind {
    fn from(transport: Simulated) -> Self {
        Self::Simulated(transport)
    }
}

/// The transports that a command line names by an address: each returns the bus at an address of
/// this transport, and `None` for another text. The bit rate is that of a bus whose bit rate motord
/// sets.
#[cfg(feature = "linux")]
const TRANSPORTS: [fn(&str, u32) -> Option<BusKind>; 2] = [
    |address, bitrate| Serial::at(address, bitrate).map(BusKind::from),
    |address, bitrate| SocketCan::at(address, bitrate).map(BusKind::from),
];

/// Returns the bus at `address`, such as `can0` or `/dev/ttyUSB0`; `None` where the text is no
/// address of any transport.
#[cfg(feature = "linux")]
#[must_use]
pub fn find(address: &str, bitrate: u32) -> Option<BusKind> {
    TRANSPORTS.iter().find_map(|at| at(address, bitrate))
}

#[cfg(all(test, feature = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn address_names_its_transport() {
        let name = |address| find(address, 921_600).map(|kind| kind.name());
        assert_eq!(name("can0"), Some("socketcan"));
        assert_eq!(name("/dev/ttyUSB0"), Some("serial"));
        for text in ["", "can 0", "..", "an-interface-of-17"] {
            assert_eq!(name(text), None, "{text}");
        }
    }

    #[test]
    fn transport_is_found_by_its_address() {
        let kinds: [BusKind; 2] = [
            SocketCan::at("can1", 500_000).unwrap().into(),
            Serial::at("/dev/ttyACM1", 115_200).unwrap().into(),
        ];
        for kind in kinds {
            let address = kind.address().expect("it is outside of the daemon");
            assert_eq!(find(address, kind.bitrate()), Some(kind.clone()));
        }
    }

    #[test]
    fn only_simulated_bus_has_no_hardware() {
        let simulated: BusKind = Simulated { bitrate: 1_000_000, seed: 7 }.into();
        assert!(simulated.hardware().is_none() && simulated.address().is_none());
        for address in ["can0", "/dev/ttyUSB0"] {
            assert!(find(address, 1).is_some_and(|kind| kind.hardware().is_some() && !kind.is_simulated()));
        }
    }
}

/// A simulated CAN bus. The crate that has the simulator builds it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Simulated {
    /// Bit/s.
    pub bitrate: u32,
    /// Seed of everything random in it.
    pub seed: u64,
}

impl Simulated {
    /// Its type in configurations.
    pub const NAME: &'static str = "simulated";
}

impl Transport for Simulated {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn bitrate(&self) -> u32 {
        self.bitrate
    }

    fn seed(&self) -> Option<u64> {
        Some(self.seed)
    }
}
