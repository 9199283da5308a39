//! The tables of the whole file.

use toml::de::{DeTable, DeValue};

use super::entry::Item;
use super::findings::Findings;
use super::keys::{self, SECTIONS};
use super::problem::Wrong;
use super::similar::closest;
use super::table::{Section, Table};

/// The whole file with all keys read.
pub(super) struct Document {
    pub(super) daemon: keys::Daemon,
    pub(super) cycle: keys::Cycle,
    pub(super) ipc: keys::Ipc,
    pub(super) telemetry: keys::Telemetry,
    pub(super) safety: keys::Safety,
    pub(super) buses: Vec<Item<keys::Bus>>,
    pub(super) motors: Vec<Item<MotorTables>>,
    pub(super) groups: Vec<Item<keys::Group>>,
    pub(super) sensors: keys::Sensors,
}

/// A `[[motor]]` with its tables.
pub(super) struct MotorTables {
    pub(super) keys: keys::Motor,
    pub(super) limits: keys::Limits,
    pub(super) simulation: keys::Simulation,
}

/// Names of a file that are compared with those of a configuration.
const COMPARED_MAX: usize = 1000;

/// The old name of `[ipc]`.
const OLD_IPC: &str = "exchange";

/// Returns what a file is that has nothing of a configuration in it.
pub(super) fn foreign(root: &DeTable<'_>) -> Option<Wrong> {
    let has = |name: &str| root.contains_key(name);
    if has("form") && has(keys::Motor::PATH) && !has(keys::Bus::PATH) {
        return Some(Wrong::LockFile);
    }
    let is_near = |name: &str| {
        let names = || SECTIONS.iter().map(|(path, _)| *path).chain([OLD_IPC]);
        let is_key = SECTIONS.iter().any(|(_, keys)| keys.contains(&name));
        names().any(|known| known == name) || is_key || closest(name, names()).is_some()
    };
    let is_table = |name: &str| root.get(name).is_some_and(|value| is_table(value.get_ref()));
    let names = || root.keys().map(|key| key.get_ref().as_ref());
    let tables = || names().filter(|name| is_table(name)).take(COMPARED_MAX);
    let is_known =
        tables().any(is_near) || (tables().next().is_none() && names().take(COMPARED_MAX).any(is_near));
    (!is_known).then_some(Wrong::NoConfiguration)
}

fn is_table(value: &DeValue<'_>) -> bool {
    value.is_table()
        || value.as_array().is_some_and(|items| items.iter().all(|item| item.get_ref().is_table()))
}

impl Document {
    pub(super) fn read(root: &DeTable<'_>, findings: &mut Findings<'_>) -> Self {
        let mut root = Table::of_file(root, SECTIONS, findings);
        root.refuse_unknown(&[OLD_IPC], &[]);
        let ipc = root.renamed(OLD_IPC, keys::Ipc::PATH);
        Self {
            daemon: root.section(keys::Daemon::PATH),
            cycle: root.section(keys::Cycle::PATH),
            ipc: root.section(ipc),
            telemetry: root.section(keys::Telemetry::PATH),
            safety: root.section(keys::Safety::PATH),
            buses: root.list(),
            motors: root.list(),
            groups: root.list(),
            sensors: keys::Sensors::read(&mut root),
        }
    }
}

impl Section for MotorTables {
    const PATH: &'static str = keys::Motor::PATH;
    const KEYS: &'static [&'static str] = keys::Motor::KEYS;
    const UNITS: &'static [&'static str] = keys::Motor::UNITS;

    fn read(table: &mut Table<'_, '_, '_>) -> Self {
        Self {
            keys: keys::Motor::read(table),
            limits: table.section(keys::Limits::PATH),
            simulation: table.section(keys::Simulation::PATH),
        }
    }
}
