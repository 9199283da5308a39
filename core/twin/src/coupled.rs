//! The robot of a configuration without its hardware, and the mechanics that move its joints.

use crate::error::TwinError;
use crate::joints::{JointPlant, Mechanics};
use crate::physics::simulate;
use motord_bus::transport::Simulated;
use motord_settings::sensor::imu::{ImuCan, ImuSimulation, ImuSource, Mount};
use motord_settings::settings::Settings;
use motord_simulator::{PlantBus, SharedBus, couple};

/// Makes every bus and every IMU a simulated one. An IMU keeps the errors of its
/// `[imu.simulation]`, and is aligned with the body.
///
/// # Errors
/// [`TwinError::SerialBus`].
pub fn simulate_all(settings: &mut Settings) -> Result<(), TwinError> {
    for bus in &mut settings.buses {
        if bus.is_line() {
            return Err(TwinError::SerialBus { bus: bus.name.clone() });
        }
        let (bitrate, seed) = (bus.kind.bitrate(), bus.kind.seed().unwrap_or(0));
        bus.kind = Simulated { bitrate, seed }.into();
    }
    for imu in &mut settings.sensors.imus {
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

/// Builds the simulated buses of `settings`, whose motors `mechanics` move, with the seed of each.
/// The joints begin where the mechanics have them, and `settings` says so afterwards. Returns the
/// buses to inject faults, and those for the cycle.
///
/// # Errors
/// [`TwinError::Begin`].
pub fn coupled(
    settings: &mut Settings,
    seed: impl Fn(usize) -> u64,
    mechanics: Box<dyn Mechanics>,
) -> Result<(Vec<SharedBus>, Vec<PlantBus>), TwinError> {
    let plant = JointPlant::new(mechanics, settings)?;
    let buses = alone(settings, seed);
    let coupled = couple(&buses, plant);
    Ok((buses, coupled))
}

/// Builds the simulated buses of `settings`, whose motors turn by themselves, with the seed of
/// each.
pub(crate) fn alone(settings: &Settings, seed: impl Fn(usize) -> u64) -> Vec<SharedBus> {
    let bus = |index: usize| SharedBus::new(simulate(settings, index, seed(index)));
    (0..settings.buses.len()).map(bus).collect()
}
