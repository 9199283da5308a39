//! Reads the tables and keys of a vendor's file, and collects its problems.

use core::cell::RefCell;
use core::fmt;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Least similarity (Jaro-Winkler) of a suggestion; 1 is equal.
const ALIKE: f64 = 0.8;
/// Letters of the file that a message quotes.
const QUOTED_MAX: usize = 40;

/// A problem of a vendor's file, and its place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileProblem {
    /// Counted from 1.
    pub line: usize,
    /// Characters from the begin of the line, counted from 1.
    pub column: usize,
    /// The dotted key; empty where the text is no TOML.
    pub key: String,
    /// The problem, and the remedy.
    pub message: String,
}

impl fmt::Display for FileProblem {
    /// `LINE:COLUMN: KEY: what is wrong; what to do`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { line, column, key, message } = self;
        write!(f, "{line}:{column}: ")?;
        if !key.is_empty() {
            write!(f, "{key}: ")?;
        }
        f.write_str(message)
    }
}

/// The problems of one file.
#[derive(Debug)]
pub(super) struct Findings<'t> {
    text: &'t str,
    problems: RefCell<Vec<FileProblem>>,
}

impl<'t> Findings<'t> {
    pub(super) const fn new(text: &'t str) -> Self {
        Self { text, problems: RefCell::new(Vec::new()) }
    }

    /// Adds a problem at the byte `offset`.
    pub(super) fn add(&self, offset: usize, key: &str, message: impl Into<String>) {
        let before = self.text.get(..offset).unwrap_or(self.text);
        let (line, column) = match before.rsplit_once('\n') {
            Some((lines, rest)) => (lines.matches('\n').count() + 2, rest.chars().count() + 1),
            None => (1, before.chars().count() + 1),
        };
        let (key, message) = (plain(key), message.into());
        self.problems.borrow_mut().push(FileProblem { line, column, key, message });
    }

    /// Returns the problems in the order of the file.
    pub(super) fn into_problems(self) -> Vec<FileProblem> {
        let mut problems = self.problems.into_inner();
        problems.sort_by_key(|problem| (problem.line, problem.column));
        problems
    }
}

/// A table of the file, or one that is not written.
#[derive(Clone)]
pub(super) struct Table<'t> {
    findings: &'t Findings<'t>,
    path: String,
    offset: usize,
    table: Option<&'t DeTable<'t>>,
}

impl<'t> Table<'t> {
    pub(super) fn root(findings: &'t Findings<'t>, table: &'t DeTable<'t>) -> Self {
        Self { findings, path: String::new(), offset: 0, table: Some(table) }
    }

    /// Reports every key that is not `known`.
    pub(super) fn refuse_unknown(&self, known: &[&str]) {
        for key in self.table.into_iter().flat_map(DeTable::keys) {
            let written = key.get_ref().as_ref();
            if !known.contains(&written) {
                let hint = suggestion(written, known.iter().copied());
                let message = format!("unknown key `{}`; {hint}", plain(written));
                self.findings.add(key.span().start, &self.dotted(written), message);
            }
        }
    }

    /// Reports a problem with the value of `key`; of the table, if it is not written.
    pub(super) fn problem(&self, key: &str, message: impl Into<String>) {
        let offset = self.value(key).map_or(self.offset, |value| value.span().start);
        self.findings.add(offset, &self.dotted(key), message);
    }

    /// Reports a missing key.
    pub(super) fn require<T>(&self, key: &str, value: Option<T>, hint: &str) -> Option<T> {
        if value.is_none() && self.value(key).is_none() {
            self.problem(key, format!("is missing; {hint}"));
        }
        value
    }

    pub(super) fn has(&self, key: &str) -> bool {
        self.value(key).is_some()
    }

    fn value(&self, key: &str) -> Option<&'t Spanned<DeValue<'t>>> {
        self.table?.get(key)
    }

    fn dotted(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }

    /// Reads a value, and reports one of another sort.
    fn read<T>(&self, key: &str, expected: &str, read: impl Fn(&'t DeValue<'t>) -> Option<T>) -> Option<T> {
        let written = self.value(key)?;
        let value = read(written.get_ref());
        if value.is_none() {
            let found = self.findings.text.get(written.span()).unwrap_or_default();
            let found: String = found.chars().take(QUOTED_MAX).collect();
            self.problem(key, format!("expected {expected}, found {}; write {expected}", plain(&found)));
        }
        value
    }

    pub(super) fn text(&self, key: &str) -> Option<&'t str> {
        self.read(key, "a text", |value| value.as_str())
    }

    pub(super) fn texts(&self, key: &str) -> Option<Vec<&'t str>> {
        let read =
            |value: &'t DeValue<'t>| value.as_array()?.iter().map(|item| item.get_ref().as_str()).collect();
        self.read(key, "a list of texts", read)
    }

    pub(super) fn flag(&self, key: &str) -> Option<bool> {
        self.read(key, "true or false", DeValue::as_bool)
    }

    /// Reads an integer from `least` to `most`.
    pub(super) fn integer(&self, key: &str, least: i64, most: i64) -> Option<i64> {
        let value = self.read(key, "an integer", integer)?;
        self.within(key, value, least, most)
    }

    /// Reads a list of integers from `least` to `most`.
    pub(super) fn integers(&self, key: &str, least: i64, most: i64) -> Option<Vec<i64>> {
        let read =
            |value: &'t DeValue<'t>| value.as_array()?.iter().map(|item| integer(item.get_ref())).collect();
        let values: Vec<i64> = self.read(key, "a list of integers", read)?;
        values.into_iter().map(|value| self.within(key, value, least, most)).collect()
    }

    /// Reads the fewest and most bytes of a frame.
    pub(super) fn lengths(&self, key: &str, least: i64) -> Option<[usize; 2]> {
        let values = self.integers(key, least, 8)?;
        let &[fewest, most] = &values[..] else {
            self.problem(key, "lists fewest and most bytes; write two integers, such as [8, 8]");
            return None;
        };
        if fewest > most {
            self.problem(key, format!("is reversed: fewest bytes first; write [{most}, {fewest}]"));
        }
        Some([fewest as usize, most as usize])
    }

    fn within(&self, key: &str, value: i64, least: i64, most: i64) -> Option<i64> {
        if (least..=most).contains(&value) {
            return Some(value);
        }
        self.problem(key, format!("{value} is out of range; give an integer from {least} to {most}"));
        None
    }

    /// Reads a finite number above 0, and at most `most`.
    pub(super) fn number(&self, key: &str, most: f64) -> Option<f64> {
        let value: f64 = self.read(key, "a number", |value| digits(value)?.parse().ok())?;
        if value > 0.0 && value <= most {
            return Some(value);
        }
        let wrong = if value.is_finite() { "out of range" } else { "not a finite number" };
        let hint = match key.contains("-end") {
            true if value < 0.0 => ": the range would be reversed",
            true if value == 0.0 => ": the range would be empty",
            _ => "",
        };
        self.problem(key, format!("{value} is {wrong}{hint}; give a number above 0, at most {most}"));
        None
    }

    /// Reads a number in single precision, rounded once.
    pub(super) fn single(&self, key: &str, most: f64) -> Option<f32> {
        self.number(key, most)?;
        digits(self.value(key)?.get_ref())?.parse().ok()
    }

    /// Returns the table `key`. Without it, a table without keys.
    pub(super) fn section(&self, key: &str) -> Self {
        let table = self.read(key, &format!("a table [{}]", self.dotted(key)), |value| value.as_table());
        let offset = self.value(key).map_or(self.offset, |value| value.span().start);
        Self { findings: self.findings, path: self.dotted(key), offset, table }
    }

    /// Returns the tables `[[key]]`.
    pub(super) fn list(&self, key: &str) -> Vec<Self> {
        let expected = format!("tables [[{}]]", self.dotted(key));
        let read = |value: &'t DeValue<'t>| {
            let items = value.as_array()?.iter();
            items
                .map(|item| Some((item.span().start, item.get_ref().as_table()?)))
                .collect::<Option<Vec<_>>>()
        };
        let items = self.read(key, &expected, read).unwrap_or_default();
        let table = |(offset, table)| Self {
            findings: self.findings,
            path: self.dotted(key),
            offset,
            table: Some(table),
        };
        items.into_iter().map(table).collect()
    }

    /// Returns the keys as they are written, with the number that each is, at most `most`, in the
    /// order of the numbers.
    pub(super) fn numbered(&self, most: u32) -> Vec<(&'t str, u32)> {
        let mut numbered = Vec::new();
        for key in self.table.into_iter().flat_map(DeTable::keys) {
            let written = key.get_ref().as_ref();
            let number = match written.strip_prefix("0x") {
                Some(digits) => u32::from_str_radix(digits, 16),
                None => written.parse(),
            };
            match number {
                Ok(number) if number <= most => numbered.push((number, key.span().start, written)),
                _ => {
                    let message = format!(
                        "`{}` is no number from 0 to {most}; write one, such as 3 or 0x3",
                        plain(written)
                    );
                    self.findings.add(key.span().start, &self.dotted(written), message);
                }
            }
        }
        numbered.sort_unstable();
        numbered.into_iter().map(|(number, _, written)| (written, number)).collect()
    }
}

/// Returns an integer with any base.
fn integer(value: &DeValue<'_>) -> Option<i64> {
    let integer = value.as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

/// Returns the digits of a number with the base 10.
fn digits<'t>(value: &'t DeValue<'_>) -> Option<&'t str> {
    match value {
        DeValue::Float(float) => Some(float.as_str()),
        DeValue::Integer(integer) if integer.radix() == 10 => Some(integer.as_str()),
        _ => None,
    }
}

/// Returns a hint for an unknown name: the most similar known name, or all of them.
pub(super) fn suggestion<'k>(written: &str, known: impl Iterator<Item = &'k str>) -> String {
    let known: Vec<_> = known.collect();
    let likeness = |name: &&&str| strsim::jaro_winkler(&written.to_lowercase(), name);
    match known
        .iter()
        .max_by(|a, b| likeness(a).total_cmp(&likeness(b)))
        .filter(|name| likeness(name) >= ALIKE)
    {
        Some(name) => format!("did you mean `{name}`?"),
        None => format!("known are {}", known.join(", ")),
    }
}

/// Returns `text` in one line, with spaces for control characters.
pub(super) fn plain(text: &str) -> String {
    text.chars().map(|letter| if letter.is_control() { ' ' } else { letter }).collect()
}

/// Keeps a text for the life of the process.
pub(super) fn keep(text: &str) -> &'static str {
    text.to_owned().leak()
}
