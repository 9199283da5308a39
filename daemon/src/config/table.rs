//! One table of the file: its keys are read one by one, and what is not a key is reported.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::entry::{At, Entry, Rule};
use super::findings::Findings;
use super::keys::{self, SECTIONS, Section};
use super::problem::{Wrong, plain};
use super::similar::suggestion;
use super::value::{Value, kind};

/// The whole file, read.
pub(super) struct Document {
    pub(super) daemon: keys::Daemon,
    pub(super) cycle: keys::Cycle,
    pub(super) ipc: keys::Ipc,
    pub(super) safety: keys::Safety,
    pub(super) buses: Vec<Item<keys::Bus>>,
    pub(super) motors: Vec<Item<Motor>>,
    pub(super) groups: Vec<Item<keys::Group>>,
}

/// An item of a `[[list]]`, and where it begins.
pub(super) struct Item<T> {
    pub(super) at: At,
    pub(super) keys: T,
}

/// A `[[motor]]` with its tables.
pub(super) struct Motor {
    pub(super) keys: keys::Motor,
    pub(super) limits: keys::Limits,
    pub(super) simulation: keys::Simulation,
}

/// The old name of `[ipc]`.
const EXCHANGE: &str = "exchange";

impl Document {
    pub(super) fn read(root: &DeTable<'_>, findings: &mut Findings<'_>) -> Self {
        let mut root = Table::new("", Some(root), 0, findings);
        root.refuse_unknown(&[EXCHANGE]);
        let ipc = root.ipc_path();
        Self {
            daemon: root.section(keys::Daemon::PATH),
            cycle: root.section(keys::Cycle::PATH),
            ipc: root.section(ipc),
            safety: root.section(keys::Safety::PATH),
            buses: root.list(),
            motors: root.list(),
            groups: root.list(),
        }
    }
}

impl Section for Motor {
    const PATH: &'static str = keys::Motor::PATH;
    const KEYS: &'static [&'static str] = keys::Motor::KEYS;

    fn read(table: &mut Table<'_, '_, '_>) -> Self {
        Self {
            keys: keys::Motor::read(table),
            limits: table.section(keys::Limits::PATH),
            simulation: table.section(keys::Simulation::PATH),
        }
    }
}

/// A table while it is read. One that is not in the file has no keys.
pub(super) struct Table<'t, 'f, 'a> {
    path: &'static str,
    table: Option<&'t DeTable<'t>>,
    offset: usize,
    findings: &'f mut Findings<'a>,
}

impl<'t, 'f, 'a> Table<'t, 'f, 'a> {
    fn new(
        path: &'static str,
        table: Option<&'t DeTable<'t>>,
        offset: usize,
        findings: &'f mut Findings<'a>,
    ) -> Self {
        Self { path, table, offset, findings }
    }

    /// Reads one key. A bad value is reported, and the default stands for it.
    pub(super) fn entry<T: Value>(
        &mut self,
        key: &'static str,
        unit: &'static str,
        rule: Rule<T>,
    ) -> Entry<T> {
        let at = At { offset: self.offset, section: self.path, key };
        let Some(written) = self.table.and_then(|table| table.get(key)) else {
            if let Some(hint) = rule.required {
                self.findings.error(at, Wrong::Missing(hint));
            }
            return Entry { value: rule.default, at, is_written: false };
        };
        let at = At { offset: written.span().start, ..at };
        let value = match rule.read(written, unit) {
            Ok(value) => {
                rule.doubt(&value).into_iter().for_each(|wrong| self.findings.warn(at, wrong));
                value
            }
            Err(wrong) => {
                self.findings.error(at, wrong);
                rule.default
            }
        };
        Entry { value, at, is_written: true }
    }

    /// Every key of this table.
    fn keys<S: Section>(&mut self) -> S {
        self.refuse_unknown(S::KEYS);
        S::read(self)
    }

    /// The table `[path]`.
    fn section<S: Section>(&mut self, path: &'static str) -> S {
        let written = self.table.and_then(|table| table.get(last(path)));
        let table = written.and_then(|written| written.get_ref().as_table());
        if let (Some(written), None) = (written, table) {
            let wrong = match written.get_ref() {
                DeValue::Array(_) => Wrong::OneTable(path),
                other => Wrong::Type { expected: "a table", found: kind(other) },
            };
            self.findings.error(at(path, written), wrong);
        }
        let offset = written.map_or(self.offset, |written| written.span().start);
        Table::new(path, table, offset, self.findings).keys()
    }

    /// Every table `[[list]]`. A single `[list]` is reported, and read as one.
    fn list<S: Section>(&mut self) -> Vec<Item<S>> {
        let Some(written) = self.table.and_then(|table| table.get(S::PATH)) else { return Vec::new() };
        if written.get_ref().is_table() {
            self.findings.error(at(S::PATH, written), Wrong::ListOfTables(S::PATH));
        }
        let items = written.get_ref().as_array();
        let items: Vec<_> = items.map_or_else(|| vec![written], |items| items.iter().collect());
        items.into_iter().filter_map(|item| self.item(item)).collect()
    }

    fn item<S: Section>(&mut self, written: &Spanned<DeValue<'_>>) -> Option<Item<S>> {
        let at = at(S::PATH, written);
        let table = written.get_ref().as_table();
        if table.is_none() {
            self.findings.error(at, Wrong::Type { expected: "a table", found: kind(written.get_ref()) });
        }
        let mut table = Table::new(S::PATH, Some(table?), at.offset, self.findings);
        Some(Item { at, keys: table.keys() })
    }

    /// Reports every key that is neither one of `keys` nor a table below this one.
    fn refuse_unknown(&mut self, keys: &[&'static str]) {
        let known: Vec<_> = keys.iter().copied().chain(tables_below(self.path)).collect();
        let unknown = |key: &str| !known.contains(&key);
        for (key, _) in self.table.into_iter().flatten().filter(|(key, _)| unknown(key.get_ref())) {
            let name = key.get_ref().as_ref();
            let hint = match home_of(name, self.path) {
                Some(section) => format!("it belongs in {}", header(section)),
                None => suggestion(name, known.iter().copied()),
            };
            let wrong = Wrong::UnknownKey { key: plain(name), hint };
            self.findings.error_of_key(self.path, name, key.span().start, wrong);
        }
    }

    /// `[ipc]`, or its old name where only that is there.
    fn ipc_path(&mut self) -> &'static str {
        let written = |path| self.table.and_then(|table| table.get(path));
        match (written(keys::Ipc::PATH), written(EXCHANGE)) {
            (None, Some(_)) => EXCHANGE,
            (Some(_), Some(old)) => {
                let wrong = Wrong::OldAndNewName { old: EXCHANGE, new: keys::Ipc::PATH };
                self.findings.error(at(EXCHANGE, old), wrong);
                keys::Ipc::PATH
            }
            _ => keys::Ipc::PATH,
        }
    }
}

/// Where the table `path` is written.
fn at(path: &'static str, written: &Spanned<DeValue<'_>>) -> At {
    At { offset: written.span().start, section: path, key: "" }
}

/// The names of the tables one level below `path`.
fn tables_below(path: &'static str) -> impl Iterator<Item = &'static str> {
    let below = move |section: &'static str| match path {
        "" => Some(section),
        path => section.strip_prefix(path)?.strip_prefix('.'),
    };
    SECTIONS.iter().filter_map(move |(section, _)| below(section)).filter(|name| !name.contains('.'))
}

/// The section that a key belongs in which is unknown in `path`: one of the same list, or the only one that has it.
fn home_of(key: &str, path: &str) -> Option<&'static str> {
    let homes: Vec<_> =
        SECTIONS.iter().filter(|(_, keys)| keys.contains(&key)).map(|(path, _)| *path).collect();
    let related = homes.iter().find(|home| home.split('.').next() == path.split('.').next());
    related.or(homes.first().filter(|_| homes.len() == 1)).copied()
}

/// `[cycle]`, or `[[motor]]` where there can be several.
fn header(path: &str) -> String {
    match [keys::Bus::PATH, keys::Motor::PATH, keys::Group::PATH].contains(&path) {
        true => format!("[[{path}]]"),
        false => format!("[{path}]"),
    }
}

/// The last name of a path: `limits` of `motor.limits`.
fn last(path: &'static str) -> &'static str {
    path.rsplit('.').next().unwrap_or(path)
}
