//! Creates a cycle from settings, and the ends for other threads.

use super::{Cycle, Ends, link};
use motord_bus::{Bus, Clock};
use motord_settings::plan::BusPlan;
use motord_settings::settings::Settings;

/// Creates the cycle of `settings` on `buses`, and its other ends. Allocates; nothing in the cycle
/// does after it.
///
/// `buses` stand in the order of the configuration, and are open. `clock` is the machine's or one
/// of virtual time. `boot_id` must differ from that of every earlier run whose leases a client may
/// still hold. Any number is correct where all clients are in this program.
///
/// # Panics
///
/// When there are not as many buses as in the settings, or a motor is not in exactly one group.
#[must_use]
pub fn assemble(
    settings: &Settings,
    buses: Vec<Box<dyn Bus>>,
    clock: impl Clock + Send + 'static,
    boot_id: u64,
) -> (Cycle, Ends) {
    assert_eq!(buses.len(), settings.buses.len(), "every bus of the settings is there");
    let (link, ends) = link(settings.groups.len(), settings.sensors.imus.len());
    (Cycle::new(settings, &BusPlan::of(settings), buses, Box::new(clock), link, boot_id), ends)
}
