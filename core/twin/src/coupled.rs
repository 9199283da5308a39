//! The robot of a configuration without its hardware, and the mechanics that move its joints.

use crate::joints::{JointPlant, Mechanics};
use crate::physics::simulate;
use motord_configuration::ConfigError;
use motord_core::imu::{ImuCan, ImuSimulation, ImuSource, Mount};
use motord_core::settings::{BusKind, Settings};
use motord_simulator::{PlantBus, SharedBus, couple};

/// The reason why a configuration has no twin.
#[derive(Debug)]
pub enum TwinError {
    /// The configuration has errors.
    Configuration(ConfigError),
    /// The twin has no serial lines.
    SerialBus {
        /// The name of the bus.
        bus: String,
    },
}

impl core::fmt::Display for TwinError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Configuration(error) => error.fmt(f),
            Self::SerialBus { bus } => write!(
                f,
                "bus {bus} is a serial line, which a twin does not have: give its motors a CAN bus for the twin"
            ),
        }
    }
}

impl core::error::Error for TwinError {}

/// Makes every bus and every IMU a simulated one. An IMU keeps the errors of its `[imu.simulation]`, and is aligned with the body.
///
/// # Errors
/// [`TwinError::SerialBus`].
pub fn simulate_all(settings: &mut Settings) -> Result<(), TwinError> {
    for bus in &mut settings.buses {
        if bus.is_line() {
            return Err(TwinError::SerialBus { bus: bus.name.clone() });
        }
        if let BusKind::SocketCan { bitrate, .. } = bus.kind {
            bus.kind = BusKind::Simulated { bitrate, seed: 0 };
        }
    }
    for imu in &mut settings.imus {
        let errors = match &imu.source {
            ImuSource::Simulated(errors) | ImuSource::Can(ImuCan { simulation: errors, .. }) => {
                errors.clone()
            }
            ImuSource::Serial(_) | ImuSource::External => ImuSimulation::PERFECT,
        };
        (imu.source, imu.mount) = (ImuSource::Simulated(errors), Mount::ALIGNED);
    }
    Ok(())
}

/// Builds the simulated buses of `settings`, whose motors `mechanics` move, with the seed of each. The joints begin where the
/// mechanics have them, and `settings` says so afterwards. Returns the buses to inject faults, and those for the cycle.
pub fn coupled(
    settings: &mut Settings,
    seed: impl Fn(usize) -> u64,
    mechanics: Box<dyn Mechanics>,
) -> (Vec<SharedBus>, Vec<PlantBus>) {
    let plant = JointPlant::new(mechanics, settings);
    let buses = alone(settings, seed);
    let coupled = couple(&buses, plant);
    (buses, coupled)
}

/// Builds the simulated buses of `settings`, whose motors turn by themselves, with the seed of each.
pub(crate) fn alone(settings: &Settings, seed: impl Fn(usize) -> u64) -> Vec<SharedBus> {
    let bus = |index: usize| SharedBus::new(simulate(settings, index, seed(index)));
    (0..settings.buses.len()).map(bus).collect()
}
