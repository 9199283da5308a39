//! Reads one table of the file key by key, and reports unknown keys.

use motord_shared::limits::JOINTS_MAX;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::entry::{At, Entry, Item, Rule, Written};
use super::findings::Findings;
use super::other_unit;
use super::problem::{Wrong, plain};
use super::similar::{closest, suggestion, with_words};
use super::sort::found;
use super::value::Value;

/// Most tables of any list of the file.
const LIST_MAX: usize = JOINTS_MAX;

/// A kind of table: its keys, all read.
pub(super) trait Section: Sized {
    /// The name in the file: `cycle`, `motor.limits`.
    const PATH: &'static str;
    /// The names of its keys.
    const KEYS: &'static [&'static str];
    /// Their units; empty for a key without one.
    const UNITS: &'static [&'static str];

    /// Reads every key. A key that is missing or wrong has its default.
    fn read(table: &mut Table<'_, '_, '_>) -> Self;
}

/// Path and keys of every section there is.
pub(super) type Sections = &'static [(&'static str, &'static [&'static str])];

/// A table that is being read. A table that is not in the file has no keys.
pub(super) struct Table<'t, 'f, 'a> {
    path: &'static str,
    table: Option<&'t DeTable<'t>>,
    offset: usize,
    known: Sections,
    findings: &'f mut Findings<'a>,
}

impl<'t, 'f, 'a> Table<'t, 'f, 'a> {
    /// The table of the whole file; `known` are the sections that it can have.
    pub(super) fn of_file(root: &'t DeTable<'t>, known: Sections, findings: &'f mut Findings<'a>) -> Self {
        Self { path: "", table: Some(root), offset: 0, known, findings }
    }

    /// The table `path` below this one.
    fn below<'s>(
        &'s mut self,
        path: &'static str,
        table: Option<&'s DeTable<'s>>,
        offset: usize,
    ) -> Table<'s, 's, 'a> {
        Table { path, table, offset, known: self.known, findings: self.findings }
    }

    /// Reads one key. Reports an invalid value, and replaces it by the default.
    pub(super) fn entry<T: Value>(
        &mut self,
        key: &'static str,
        unit: &'static str,
        rule: Rule<T>,
    ) -> Entry<T> {
        let at = At { offset: self.offset, section: self.path, key };
        let Some(written) = self.table.and_then(|table| table.get(key)) else {
            if let Some(advice) = rule.required {
                self.findings.error(at, Wrong::Missing(advice.text::<T>()));
            }
            return Entry { value: rule.default, at, unit, is_written: false };
        };
        let at = At { offset: written.span().start, ..at };
        let source = self.findings.source(written.span());
        let value = match rule.read(key, Written { value: written, source }, unit) {
            Ok(value) => {
                rule.warning(&value).into_iter().for_each(|wrong| self.findings.warn(at, wrong));
                value
            }
            Err(wrong) => {
                self.findings.error(at, wrong);
                rule.default
            }
        };
        Entry { value, at, unit, is_written: true }
    }

    /// Every key of this table.
    fn keys<S: Section>(&mut self) -> S {
        self.refuse_unknown(S::KEYS, S::UNITS);
        S::read(self)
    }

    /// The table `[path]`.
    pub(super) fn section<S: Section>(&mut self, path: &'static str) -> S {
        let written = self.table.and_then(|table| table.get(last(path)));
        let table = written.and_then(|written| written.get_ref().as_table());
        if let (Some(written), None) = (written, table) {
            let wrong = match written.get_ref() {
                DeValue::Array(items) if items.iter().all(|item| item.get_ref().is_table()) => {
                    Wrong::OneTable(path)
                }
                _ if path.contains('.') => {
                    self.no_table("a table", written, &format!("write {} = {{ KEY = VALUE }}", last(path)))
                }
                _ => self.no_table("a table", written, &below_header(&format!("[{path}]"))),
            };
            self.findings.error(at(path, written), wrong);
        }
        let offset = written.map_or(self.offset, |written| written.span().start);
        self.below(path, table, offset).keys()
    }

    /// Reads every table `[[list]]`. Reports a single `[list]`, and reads it as one.
    pub(super) fn list<S: Section>(&mut self) -> Vec<Item<S>> {
        let Some(written) = self.table.and_then(|table| table.get(S::PATH)) else { return Vec::new() };
        if written.get_ref().is_table() {
            self.findings.error(at(S::PATH, written), Wrong::ListOfTables(S::PATH));
        }
        let items = written.get_ref().as_array();
        let mut items: Vec<_> = items.map_or_else(|| vec![written], |items| items.iter().collect());
        // One more than any list may have, for the error. The checks of more would take minutes.
        if items.len() > LIST_MAX {
            self.findings.mark_malformed(S::PATH);
            items.truncate(LIST_MAX + 1);
        }
        if items.iter().any(|item| !item.get_ref().is_table()) {
            let expected = if written.get_ref().is_array() { "tables" } else { "a table" };
            let wrong = self.no_table(expected, written, &below_header(&format!("[[{}]]", S::PATH)));
            self.findings.error(at(S::PATH, written), wrong);
            self.findings.mark_malformed(S::PATH);
        }
        items.into_iter().filter_map(|item| self.item(item)).collect()
    }

    fn item<S: Section>(&mut self, written: &Spanned<DeValue<'_>>) -> Option<Item<S>> {
        let at = at(S::PATH, written);
        let table = written.get_ref().as_table()?;
        Some(Item { at, keys: self.below(S::PATH, Some(table), at.offset).keys() })
    }

    /// The problem of a value where tables are expected.
    fn no_table(&self, expected: &str, written: &Spanned<DeValue<'_>>, cure: &str) -> Wrong {
        let found = found(written.get_ref(), self.findings.source(written.span()));
        Wrong::Type { expected: expected.into(), found: found.into(), cure: cure.into() }
    }

    /// Reports every key that is neither one of `keys` nor a table below this one.
    pub(super) fn refuse_unknown(&mut self, keys: &[&'static str], units: &[&'static str]) {
        let below = |section: &'static str| match self.path {
            "" => Some(section),
            path => section.strip_prefix(path)?.strip_prefix('.'),
        };
        let tables = self.known.iter().filter_map(|(path, _)| below(path)).filter(|name| !name.contains('.'));
        let tables: Vec<_> = tables.collect();
        let known: Vec<_> = keys.iter().copied().chain(tables.iter().copied()).collect();
        for (key, value) in self.table.into_iter().flatten() {
            let name = key.get_ref().as_ref();
            if known.contains(&name) {
                continue;
            }
            if self.findings.is_full() {
                return;
            }
            let wrong = match written_as_table(name, value.get_ref()) {
                Some(table) if self.path.is_empty() => self.unknown_table(name, table, &tables),
                table => {
                    let hint = table.and_then(|_| self.of_file_table(name));
                    let hint = hint.or_else(|| self.table_of(name));
                    let hint = hint.or_else(|| other_unit::hint((name, value), keys, units));
                    let with_words = || match closest(name, known.iter().copied()) {
                        None => with_words(name, known.iter().copied()),
                        Some(_) => None,
                    };
                    let hint = hint.or_else(|| with_words().map(|key| format!("did you mean `{key}`?")));
                    let hint = hint.unwrap_or_else(|| suggestion(name, known.iter().copied()));
                    Wrong::UnknownKey { key: plain(name), hint }
                }
            };
            self.findings.error_of_key(self.path, name, key.span().start, wrong);
        }
    }

    /// The problem of a table of the file that is none of `known`.
    fn unknown_table(&mut self, name: &str, table: String, known: &[&'static str]) -> Wrong {
        let hint = match closest(name, known.iter().copied()) {
            Some(near) => {
                self.findings.mark_malformed(near);
                format!("did you mean {}?", self.header(near))
            }
            None => {
                let known: Vec<_> = known.iter().map(|name| self.header(name)).collect();
                format!("known are {}", known.join(", "))
            }
        };
        Wrong::UnknownTable { table, hint }
    }

    /// The hint for a table of the file that was written below another one. Problems that only
    /// follow are not reported.
    fn of_file_table(&mut self, name: &str) -> Option<String> {
        let (path, _) = *self.known.iter().find(|(path, _)| *path == name)?;
        self.findings.mark_malformed(path);
        let own = self.table.and_then(|table| table.get("name")?.get_ref().as_str().map(plain));
        let more = match (path, self.path, own) {
            ("motor", "bus", Some(bus)) => format!(", and in it bus = {bus:?}"),
            _ => String::new(),
        };
        Some(format!("it is no part of {}: write {}{more}", self.header(self.path), self.header(path)))
    }

    /// Returns the tables that an unknown key belongs to: one of the same list, or the one or two
    /// that have this key.
    fn table_of(&self, key: &str) -> Option<String> {
        let has_it = self.known.iter().filter(|(_, keys)| keys.contains(&key));
        let tables: Vec<_> = has_it.map(|(path, _)| *path).collect();
        let related = tables.iter().find(|table| first(table) == first(self.path));
        let tables = related.map_or(tables.as_slice(), std::slice::from_ref);
        let headers: Vec<_> = tables.iter().map(|table| self.header(table)).collect();
        (1..=2).contains(&tables.len()).then(|| format!("it belongs in {}", headers.join(" or ")))
    }

    /// The line that begins the table `path`.
    fn header(&self, path: &str) -> String {
        if is_list(self.known, path) { format!("[[{path}]]") } else { format!("[{path}]") }
    }

    /// Returns `new`, or `old` where only that is written. Both are an error.
    pub(super) fn renamed(&mut self, old: &'static str, new: &'static str) -> &'static str {
        let written = |path| self.table.and_then(|table| table.get(path));
        match (written(new), written(old)) {
            (None, Some(_)) => old,
            (Some(_), Some(written)) => {
                self.findings.error(at(old, written), Wrong::OldAndNewName { old, new });
                new
            }
            _ => new,
        }
    }
}

/// Returns whether a file can have several tables `path`: each has a name.
pub(super) fn is_list(known: Sections, path: &str) -> bool {
    known.iter().any(|(known, keys)| *known == path && keys.contains(&"name"))
}

/// The line that begins a table of the file, as its value was written; `None` for a value that is
/// no table.
fn written_as_table(name: &str, value: &DeValue<'_>) -> Option<String> {
    let name = plain(name);
    match value {
        DeValue::Table(_) => Some(format!("[{name}]")),
        DeValue::Array(items) if items.iter().all(|item| item.get_ref().is_table()) => {
            Some(format!("[[{name}]]"))
        }
        _ => None,
    }
}

/// The cure of a value where a table is expected.
fn below_header(header: &str) -> String {
    format!("write {header} in a line of its own, and its keys below")
}

/// Where the table `path` is written.
fn at(path: &'static str, written: &Spanned<DeValue<'_>>) -> At {
    At { offset: written.span().start, section: path, key: "" }
}

/// The first name of a path: `motor` of `motor.limits`.
fn first(path: &str) -> Option<&str> {
    path.split('.').next()
}

/// The last name of a path: `limits` of `motor.limits`.
fn last(path: &'static str) -> &'static str {
    path.rsplit('.').next().unwrap_or(path)
}
