//! Opens the buses of a configuration.

pub mod claims;
pub mod fault_line;
pub mod injection;
mod opening;
pub mod other_senders;
pub mod reconnector;
pub mod watch;

pub use motord_twin::{physics, simulate};
pub use opening::{BusError, nodes, open_one};

use crate::imus::World;
use crate::plant::{Plant, PlantEnds, PlantError, PlantLink};
use claims::Claims;
use injection::Injectors;
use motord_bus::Bus;
use motord_settings::settings::Settings;
use motord_twin::{TwinError, simulate_all};
use std::path::Path;

/// The buses of a configuration, opened, and the locks that keep other daemons away from them.
pub struct Buses {
    /// In the order of the configuration.
    pub buses: Vec<Box<dyn Bus>>,
    /// Indices of the motors that differ from the configuration.
    pub mismatched: Vec<usize>,
    /// Held until they are dropped.
    pub claims: Claims,
    /// Gives faults to the buses, which are all simulated; `None` when one of them is real.
    pub injectors: Option<Injectors>,
    /// The plant that moves their motors, and the body that their IMUs measure.
    pub plant: Option<(Plant, World)>,
}

/// Why the buses could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum PlantedError {
    /// The robot has a serial line.
    #[error("{0}")]
    Twin(#[from] TwinError),
    /// There is no plant.
    #[error("{0}")]
    Plant(#[from] PlantError),
}

/// Makes every bus and IMU of `settings` a simulated one, whose joints the plant on the socket at
/// `path` moves. Blocks until the plant has answered, at most 2 minutes.
///
/// # Errors
/// The robot has a serial line, or there is no plant that takes it.
pub fn open_planted(settings: &mut Settings, path: &Path) -> Result<Buses, PlantedError> {
    simulate_all(settings)?;
    let (plant, PlantEnds { mechanics, body }) = Plant::new(PlantLink::connect(path, settings)?);
    if body.is_none() {
        settings.sensors.imus.iter().for_each(|imu| warn_of_blind(&imu.name));
    }
    let (buses, injectors) = Injectors::open_coupled(settings, mechanics)?;
    let world = body.map_or(World::Blind, World::Body);
    Ok(Buses { injectors: Some(injectors), plant: Some((plant, world)), ..Buses::of(buses) })
}

fn warn_of_blind(imu: &str) {
    tracing::warn!(
        imu,
        "gets no samples: the plant has no IMU. `python -m motord.sim live` needs --imu SITE"
    );
}

impl Buses {
    /// These buses, whose motors are the configured ones, without locks.
    #[must_use]
    pub fn of(buses: Vec<Box<dyn Bus>>) -> Self {
        Self { buses, mismatched: Vec::new(), claims: Claims::default(), injectors: None, plant: None }
    }
}

/// Locks and opens every bus.
///
/// # Errors
///
/// The first bus that cannot be opened, and why.
pub fn open(settings: &Settings) -> Result<Buses, BusError> {
    if let Some((buses, injectors)) = Injectors::open(settings) {
        return Ok(Buses { injectors: Some(injectors), ..Buses::of(buses) });
    }
    let mut opened = Buses::of(Vec::new());
    for index in 0..settings.buses.len() {
        opened.buses.push(opened.claims.open(settings, index)?);
    }
    Ok(opened)
}
