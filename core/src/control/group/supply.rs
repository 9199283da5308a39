//! Watches the supply of a group by what its motors report.
//!
//! One motor does not decide: its sensor may be broken, and the voltage at its connector falls with its
//! own current.

use crate::control::motor::Motor;
use motord_bus::{Duration, Instant};
use motord_settings::settings::SupplySettings;

/// The peaks of a gait pull the voltage down for less than this.
const TIME: Duration = Duration::from_secs(2);

/// The level of a supply: low while most motors report less than a voltage.
///
/// ```text
///            below for 2 s
///   high ──────────────────▶ low
///        ◀──────────────────
///           not below for 2 s
/// ```
#[derive(Debug)]
struct Level {
    /// V; 0 is never low.
    limit: f32,
    is_low: bool,
    /// Begin of the time in which the reports differ from `is_low`.
    since: Option<Instant>,
}

impl Level {
    const fn new(limit: f32) -> Self {
        Self { limit, is_low: false, since: None }
    }

    /// Takes the reports of all motors at `now`. Returns whether the level changed.
    fn update(&mut self, motors: &[Motor], now: Instant) -> bool {
        if is_below(self.limit, motors, now) == self.is_low {
            self.since = None;
            return false;
        }
        let since = *self.since.get_or_insert(now);
        let changes = now.since(since) >= TIME;
        if changes {
            (self.is_low, self.since) = (!self.is_low, None);
        }
        changes
    }
}

/// Returns whether more than half of the motors that report a voltage report less than `limit`, V.
fn is_below(limit: f32, motors: &[Motor], now: Instant) -> bool {
    let below = || voltages(motors, now).filter(|voltage| *voltage < limit);
    2 * below().count() > voltages(motors, now).count()
}

/// The voltages that motors reported in the last seconds.
fn voltages(motors: &[Motor], now: Instant) -> impl Iterator<Item = f32> {
    let included = motors.iter().filter(|motor| !motor.is_excluded());
    included.filter_map(move |motor| motor.supply(now)).map(|supply| supply.voltage)
}

/// The supply of a group.
#[derive(Debug)]
pub(super) struct SupplyWatch {
    warn: Level,
    stop: Level,
}

impl SupplyWatch {
    pub(super) const fn new(settings: SupplySettings) -> Self {
        Self { warn: Level::new(settings.warn), stop: Level::new(settings.stop) }
    }

    /// Takes the reports of all motors at `now`. Returns whether the supply is low from now on, or no
    /// longer; `None` without a change.
    pub(super) fn update(&mut self, motors: &[Motor], now: Instant) -> Option<bool> {
        self.stop.update(motors, now);
        self.warn.update(motors, now).then_some(self.warn.is_low)
    }

    /// Returns whether the supply is too low for motion.
    pub(super) const fn forbids_motion(&self) -> bool {
        self.stop.is_low
    }

    /// Returns whether the supply permits a start `now`: it is high enough, and known where a voltage
    /// stops the group.
    pub(super) fn permits_start(&self, motors: &[Motor], now: Instant) -> bool {
        let is_known = self.stop.limit == 0.0 || voltages(motors, now).next().is_some();
        is_known && !self.stop.is_low
    }
}
