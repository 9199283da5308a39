//! Opens the buses of a configuration.

pub mod fault_line;
pub mod injection;
mod physics;
pub mod reconnector;
pub mod watch;

pub use physics::{physics, simulate};

use injection::Injectors;

use motord_bus::serial::{self, SerialBus};
use motord_bus::socketcan::{self, InterfaceName, SocketCanBus};
use motord_bus::{Bus, BusLock, Duration, LockError};
use motord_core::drive;
use motord_core::plan::BusPlan;
use motord_core::settings::{BusKind, BusSettings, MotorSettings, Settings};

/// Why a bus could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The CAN interface cannot be used.
    #[error("bus {bus}: {source}")]
    Open {
        /// The bus.
        bus: String,
        /// Why.
        source: socketcan::OpenError,
    },
    /// The serial port cannot be used.
    #[error("bus {bus}: {source}")]
    Port {
        /// The bus.
        bus: String,
        /// Why.
        source: serial::OpenError,
    },
    /// Another daemon uses the interface or the port.
    #[error("bus {bus}: {source}")]
    Lock {
        /// The bus.
        bus: String,
        /// The lock, and who holds it.
        source: LockError,
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
    /// Indices of the motors that differ from the configuration.
    pub mismatched: Vec<usize>,
    /// Held until they are dropped.
    pub locks: Vec<BusLock>,
    /// Gives faults to the buses, which are all simulated; `None` when one of them is real.
    pub injectors: Option<Injectors>,
}

/// Locks and opens every bus.
///
/// # Errors
///
/// The first bus that cannot be opened, and why.
pub fn open(settings: &Settings) -> Result<Buses, BusError> {
    if let Some((buses, injectors)) = Injectors::open(settings) {
        return Ok(Buses { buses, mismatched: Vec::new(), locks: Vec::new(), injectors: Some(injectors) });
    }
    let mut opened = Buses { buses: Vec::new(), mismatched: Vec::new(), locks: Vec::new(), injectors: None };
    for (index, bus) in settings.buses.iter().enumerate() {
        opened.locks.extend(lock(bus)?);
        opened.buses.push(open_one(settings, index)?);
    }
    Ok(opened)
}

fn lock(bus: &BusSettings) -> Result<Option<BusLock>, BusError> {
    let lock = match &bus.kind {
        BusKind::SocketCan { interface, .. } => BusLock::interface(interface_name(bus, interface)?),
        BusKind::Serial { device, .. } => BusLock::device(device),
        BusKind::Simulated { .. } => return Ok(None),
    };
    lock.map(Some).map_err(|source| BusError::Lock { bus: bus.name.clone(), source })
}

/// Opens one bus, for the first time or again. A serial port must be closed before it is opened again.
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
                Ok(opened) => {
                    for note in opened.link().notes(*bitrate) {
                        tracing::warn!(bus = bus.name, see = "adapter", "{note}");
                    }
                    Ok(Box::new(opened))
                }
                Err(source) => Err(BusError::Open { bus: bus.name.clone(), source }),
            }
        }
        BusKind::Serial { .. } => match SerialBus::open(&line(settings, index)) {
            Ok(bus) => Ok(Box::new(bus)),
            Err(source) => Err(BusError::Port { bus: bus.name.clone(), source }),
        },
    }
}

/// The serial line with this index. A request is given up a while before the plan has the next one sent.
#[must_use]
pub fn line(settings: &Settings, index: usize) -> serial::Settings {
    let address = |motor: &MotorSettings| serial::Address {
        id: motor.id,
        host_id: u8::try_from(motor.host_id.raw()).ok(),
    };
    let motors = settings.motors.iter().filter(|motor| motor.bus == index);
    let device = match &settings.buses[index].kind {
        BusKind::Serial { device, .. } => device.clone(),
        BusKind::SocketCan { .. } | BusKind::Simulated { .. } => String::new(),
    };
    serial::Settings {
        device,
        baud: settings.buses[index].kind.bitrate(),
        addresses: motors.map(address).collect(),
        reply_timeout: reply_timeout(&BusPlan::of(settings)[index]),
        answers: drive::repeats,
    }
}

fn reply_timeout(plan: &BusPlan) -> Duration {
    plan.transaction_worst * 3 / 4
}

fn interface_name(bus: &BusSettings, interface: &str) -> Result<InterfaceName, BusError> {
    interface.parse().map_err(|_| BusError::Name { bus: bus.name.clone(), interface: interface.to_owned() })
}
