//! Opens what the configuration calls buses.

pub mod reopen;

use motord_bus::Bus;
use motord_bus::socketcan::{self, InterfaceLock, InterfaceName, LockError, OpenError, SocketCanBus};
use motord_core::settings::{BusKind, BusSettings, MotorProtocol, MotorSettings, Settings};
use motord_protocol::Model;
use motord_simulator::{self as simulator, Dialect, SimulatedBus};
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
        /// Who.
        source: LockError,
    },
    /// The cycle does not drive serial buses. Settings from a file have none: `config` refuses it in the same words.
    #[error("bus {bus}: motord does not drive serial buses yet; put the motors on a CAN bus")]
    Serial {
        /// The bus.
        bus: String,
    },
    /// The interface's name is none.
    #[error("bus {bus}: `{interface}` is no interface name: use one that `ip link` lists")]
    Name {
        /// The bus.
        bus: String,
        /// What was given.
        interface: String,
    },
}

/// The buses of a configuration, opened, and what keeps other daemons away from them.
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
    let motors: Vec<_> = settings.motors.iter().filter(|motor| motor.bus == index).collect();
    match &bus.kind {
        BusKind::Simulated { bitrate, seed } => Ok(Box::new(simulate(bus, *bitrate, *seed, &motors))),
        BusKind::SocketCan { interface, bitrate } => {
            let host_ids = motors.iter().map(|motor| motor.host_id).collect();
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

/// The simulated bus of a configuration, with its motors.
#[must_use]
pub fn simulate(bus: &BusSettings, bitrate: u32, seed: u64, motors: &[&MotorSettings]) -> SimulatedBus {
    let settings = simulator::BusSettings { name: bus.name.clone(), bitrate, ..Default::default() };
    SimulatedBus::new(settings, motors.iter().map(|motor| simulated(motor)).collect(), seed)
}

/// The current behind the largest torque code, A (MIT document 1.1).
const CURRENT_MAX: f64 = 225.0;

/// The simulated twin of a configured motor.
#[must_use]
pub fn simulated(motor: &MotorSettings) -> simulator::MotorSettings {
    let defaults = simulator::MotorSettings::default();
    let model = Model::by_name(&motor.model);
    let gear_ratio = model.map_or(defaults.gear_ratio, |model| f64::from(model.gear_ratio));
    simulator::MotorSettings {
        name: motor.name.clone(),
        id: u16::from(motor.id),
        host_id: motor.host_id.raw(),
        dialect: match motor.protocol {
            MotorProtocol::Mit => Dialect::Mit,
            MotorProtocol::Gim => Dialect::Gim,
        },
        torque_constant: motor.torque_scale.field().max() / (CURRENT_MAX * gear_ratio),
        gear_ratio,
        torque_peak: model.map_or(defaults.torque_peak, |model| f64::from(model.peak_torque)),
        velocity_max: model.map_or(defaults.velocity_max, |model| f64::from(model.max_velocity)),
        initial_position: motor.simulation.initial_position,
        load_inertia: motor.simulation.load_inertia,
        reply_latency: motor.simulation.reply_latency,
        ..defaults
    }
}
