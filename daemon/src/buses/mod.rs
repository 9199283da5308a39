//! Opens the buses of a configuration.

mod physics;
pub mod reconnector;

pub use physics::{physics, simulate};

use motord_bus::Bus;
use motord_bus::socketcan::{self, InterfaceLock, InterfaceName, LockError, OpenError, SocketCanBus};
use motord_core::settings::{BusKind, BusSettings, Settings};
use std::path::Path;

/// Why a bus could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The CAN interface cannot be used.
    #[error("bus {bus}: {source}")]
    Open {
        /// The bus.
        bus: String,
        /// Why.
        source: OpenError,
    },
    /// Another daemon uses the interface.
    #[error("bus {bus}: {source}")]
    Lock {
        /// The bus.
        bus: String,
        /// The lock, and who holds it.
        source: LockError,
    },
    /// The cycle does not drive serial buses. Settings from a file have none: `config` refuses it in the same words.
    #[error("bus {bus}: motord does not drive serial buses yet; put the motors on a CAN bus")]
    Serial {
        /// The bus.
        bus: String,
    },
    /// The text is no name of an interface.
    #[error("bus {bus}: `{interface}` is no interface name: use one that `ip link` lists")]
    Name {
        /// The bus.
        bus: String,
        /// The name in the configuration.
        interface: String,
    },
}

/// The buses of a configuration, opened, and the locks that keep other daemons away from them.
pub struct Buses {
    /// In the order of the configuration.
    pub buses: Vec<Box<dyn Bus>>,
    /// Held until they are dropped.
    pub locks: Vec<InterfaceLock>,
}

/// Opens every bus. Lock files go to `directory`.
///
/// # Errors
///
/// The first bus that cannot be opened, and why.
pub fn open(settings: &Settings, directory: &Path) -> Result<Buses, BusError> {
    let mut opened = Buses { buses: Vec::new(), locks: Vec::new() };
    for (index, bus) in settings.buses.iter().enumerate() {
        if let BusKind::SocketCan { interface, .. } = &bus.kind {
            let lock = InterfaceLock::acquire(directory, interface_name(bus, interface)?);
            opened.locks.push(lock.map_err(|source| BusError::Lock { bus: bus.name.clone(), source })?);
        }
        opened.buses.push(open_one(settings, index)?);
    }
    Ok(opened)
}

/// Opens one bus, for the first time or again.
///
/// # Errors
///
/// Why it cannot be opened.
pub fn open_one(settings: &Settings, index: usize) -> Result<Box<dyn Bus>, BusError> {
    let bus = &settings.buses[index];
    match &bus.kind {
        BusKind::Simulated { seed, .. } => Ok(Box::new(simulate(settings, index, *seed))),
        BusKind::SocketCan { interface, bitrate } => {
            let motors = settings.motors.iter().filter(|motor| motor.bus == index);
            let host_ids = motors.map(|motor| motor.host_id).collect();
            let interface = interface_name(bus, interface)?;
            let settings = socketcan::Settings { interface, bitrate: *bitrate, host_ids };
            match SocketCanBus::open(&settings) {
                Ok(bus) => Ok(Box::new(bus)),
                Err(source) => Err(BusError::Open { bus: bus.name.clone(), source }),
            }
        }
        BusKind::Serial { .. } => Err(BusError::Serial { bus: bus.name.clone() }),
    }
}

fn interface_name(bus: &BusSettings, interface: &str) -> Result<InterfaceName, BusError> {
    interface.parse().map_err(|_| BusError::Name { bus: bus.name.clone(), interface: interface.to_owned() })
}
