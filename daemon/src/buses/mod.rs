//! Opens the buses of a configuration.

pub mod claims;
pub mod fault_line;
pub mod injection;
mod opening;
pub mod reconnector;
pub mod watch;

pub use motord_twin::{physics, simulate};
pub use opening::{BusError, line, open_one};

use claims::Claims;
use injection::Injectors;
use motord_bus::Bus;
use motord_core::settings::Settings;

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
}

/// Locks and opens every bus.
///
/// # Errors
///
/// The first bus that cannot be opened, and why.
pub fn open(settings: &Settings) -> Result<Buses, BusError> {
    if let Some((buses, injectors)) = Injectors::open(settings) {
        return Ok(Buses {
            buses,
            mismatched: Vec::new(),
            claims: Claims::default(),
            injectors: Some(injectors),
        });
    }
    let mut opened =
        Buses { buses: Vec::new(), mismatched: Vec::new(), claims: Claims::default(), injectors: None };
    for index in 0..settings.buses.len() {
        opened.buses.push(opened.claims.open(settings, index)?);
    }
    Ok(opened)
}
