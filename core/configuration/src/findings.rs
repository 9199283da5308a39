//! The problems found, and the checks that several sections share.

use std::collections::{HashMap, HashSet};
use std::ops::Range;
use std::path::Path;

use motord_bus::Duration;
use motord_shared::limits::NAME_BYTES_MAX;

use super::entry::{At, Entry, Item};
use super::machine::Machine;
use super::problem::{Location, Problem, Wrong, plain};
use super::similar::suggestion;

/// Letters of a rejected name in a report.
const SHOWN_MAX: usize = 200;

/// Most problems of a report, before equal ones are joined. The place of each takes a pass over the
/// file.
const PROBLEMS_MAX: usize = 1000;

/// Errors and warnings, each with its place. At most [`PROBLEMS_MAX`]; further ones are dropped.
pub(super) struct Findings<'a> {
    file: &'a Path,
    text: &'a str,
    machine: &'a Machine,
    errors: Vec<Problem>,
    warnings: Vec<Problem>,
    /// Lists that are in the file under a wrong name or with a wrong value.
    malformed: Vec<&'static str>,
}

impl<'a> Findings<'a> {
    pub(super) fn new(file: &'a Path, text: &'a str, machine: &'a Machine) -> Self {
        Self { file, text, machine, errors: Vec::new(), warnings: Vec::new(), malformed: Vec::new() }
    }

    /// Errors and warnings, each in the order of the file.
    pub(super) fn into_problems(self) -> (Vec<Problem>, Vec<Problem>) {
        let line = |problem: &Problem| problem.location.as_ref().map(|location| location.line);
        let Self { mut errors, mut warnings, .. } = self;
        errors.sort_by_key(line);
        warnings.sort_by_key(line);
        (without_repetitions(errors), warnings)
    }

    /// Returns whether no further problem is reported.
    pub(super) fn is_full(&self) -> bool {
        self.errors.len() + self.warnings.len() >= PROBLEMS_MAX
    }

    pub(super) fn error(&mut self, at: At, wrong: Wrong) {
        // Without an error, a file with many warnings would be accepted.
        if !self.is_full() || self.errors.is_empty() {
            self.errors.push(self.problem(at, wrong));
        }
    }

    pub(super) fn warn(&mut self, at: At, wrong: Wrong) {
        if !self.is_full() {
            self.warnings.push(self.problem(at, wrong));
        }
    }

    /// An error of a key that the table of keys does not have.
    pub(super) fn error_of_key(&mut self, section: &str, key: &str, offset: usize, wrong: Wrong) {
        if !self.is_full() || self.errors.is_empty() {
            let problem = self.location(offset, path(section, &plain(key)), wrong);
            self.errors.push(problem);
        }
    }

    /// Notes that the tables of `list` are in the file in a wrong form, which was reported.
    pub(super) fn mark_malformed(&mut self, list: &'static str) {
        self.malformed.push(list);
    }

    /// Returns the part of the file at `span`.
    pub(super) fn source(&self, span: Range<usize>) -> &'a str {
        self.text.get(span).unwrap_or_default()
    }

    fn problem(&self, at: At, wrong: Wrong) -> Problem {
        self.location(at.offset, path(at.section, at.key), wrong)
    }

    fn location(&self, offset: usize, key: String, wrong: Wrong) -> Problem {
        let location = Location::at(self.text.as_bytes(), offset, Some(key));
        Problem { file: self.file.into(), location: Some(location), wrong }
    }

    /// Reports fewer than one and more than `max` tables `[[list]]`.
    pub(super) fn count<T>(&mut self, items: &[Item<T>], list: &'static str, max: usize) {
        if items.is_empty() && !self.malformed.contains(&list) {
            let whole_file = At { offset: 0, section: list, key: "" };
            let hint = match list {
                "bus" => "motord needs at least one: write [[bus]] with its name and type",
                _ => "motord needs at least one: write [[motor]] with its name, bus, id, protocol and model",
            };
            self.error(whole_file, Wrong::Missing(hint.into()));
        }
        if let Some(beyond) = items.get(max) {
            self.error(beyond.at, Wrong::TooMany { max });
        }
    }

    /// Reports every text that equals an earlier one.
    pub(super) fn unique<'e>(
        &mut self,
        entries: impl Iterator<Item = &'e Entry<Option<String>>>,
        wrong: impl Fn(String) -> Wrong,
    ) {
        let mut seen = HashSet::new();
        for entry in entries {
            if let Some(text) = &entry.value
                && !seen.insert(text)
            {
                self.error(entry.at, wrong(text.clone()));
            }
        }
    }

    /// Returns the text, if it is a valid name.
    pub(super) fn name(&mut self, entry: &Entry<Option<String>>) -> Option<String> {
        self.name_or(entry, |name| Wrong::Name { name })
    }

    /// The same; `wrong` is the error of a name with other letters.
    pub(super) fn name_or(
        &mut self,
        entry: &Entry<Option<String>>,
        wrong: impl FnOnce(String) -> Wrong,
    ) -> Option<String> {
        let name = entry.value.as_ref()?;
        let is_allowed = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if !name.is_empty() && name.len() <= NAME_BYTES_MAX && name.chars().all(is_allowed) {
            return Some(name.clone());
        }
        let letters = name.chars().count();
        let shown = name.chars().take(SHOWN_MAX).collect();
        self.error(
            entry.at,
            match letters > NAME_BYTES_MAX {
                true => Wrong::LongName { name: shown, letters },
                false => wrong(shown),
            },
        );
        None
    }

    /// Returns a text that must be written; `hint` says what to write.
    pub(super) fn required<'e>(&mut self, entry: &'e Entry<Option<String>>, hint: &str) -> Option<&'e str> {
        if !entry.is_written {
            self.error(entry.at, Wrong::Missing(hint.into()));
        }
        entry.value.as_deref()
    }

    /// Returns the path of a serial device, if it is absolute. A missing device is only a warning,
    /// because it may be connected later.
    pub(super) fn device(&mut self, entry: &Entry<Option<String>>) -> Option<String> {
        let path = self.required(entry, "give the serial device, such as device = \"/dev/ttyUSB0\"")?;
        if !Path::new(path).is_absolute() || path.contains('\0') {
            self.error(entry.at, Wrong::DevicePath { path: path.to_owned() });
            return None;
        }
        if !Path::new(path).exists() {
            self.warn(entry.at, Wrong::NoDevice(path.to_owned()));
        }
        Some(path.to_owned())
    }

    /// Returns the index of `name` among `names`. Reports an unknown name, unless one of `names` is
    /// missing or repeated: it may be that one. No `names` were reported already.
    pub(super) fn find<'n>(
        &mut self,
        at: At,
        (name, list): (&str, &'static str),
        names: impl Iterator<Item = &'n Entry<Option<String>>> + Clone,
        wrong: impl FnOnce(String, String) -> Wrong,
    ) -> Option<usize> {
        let index = names.clone().position(|known| known.value.as_deref() == Some(name));
        let known: Vec<_> = names.clone().filter_map(|known| known.value.as_deref()).collect();
        let is_whole = known.iter().collect::<HashSet<_>>().len() == names.count();
        if index.is_none() && !self.malformed.contains(&list) && !known.is_empty() && is_whole {
            let hint = suggestion(name, known.into_iter());
            self.error(at, wrong(name.to_owned(), hint));
        }
        index
    }

    pub(super) fn processor(&mut self, entry: &Entry<Option<i64>>) -> Option<usize> {
        let cpu = entry.value?;
        let allowed = &self.machine.processors;
        let found = allowed.iter().copied().find(|&one| i64::try_from(one) == Ok(cpu));
        if found.is_none() {
            let allowed = allowed.clone();
            self.error(entry.at, Wrong::Processor { cpu, allowed });
        }
        found
    }

    /// Reports a priority beyond the limit of this machine: an error where real time is required,
    /// otherwise a warning.
    pub(super) fn check_priority(&mut self, at: At, priority: u8, require_realtime: bool) {
        let allowed = self.machine.priority_max;
        let wrong = Wrong::Priority { priority, allowed };
        match priority > allowed {
            true if require_realtime => self.error(at, wrong),
            true => self.warn(at, wrong),
            false => {}
        }
    }

    pub(super) fn two_cycles(&mut self, entry: &Entry<Option<f64>>, period: Duration) {
        let period_ms = 1e3 * period.as_secs_f64();
        if let Some(value_ms) = entry.value
            && value_ms < 2.0 * period_ms
        {
            self.error(entry.at, Wrong::LessThanTwoCycles { value_ms, period_ms });
        }
    }

    pub(super) fn within_cycle(&mut self, at: At, value_us: f64, period: Duration) {
        let period_us = 1e6 * period.as_secs_f64();
        if value_us >= period_us {
            self.error(at, Wrong::NotWithinCycle { value_us, period_us });
        }
    }
}

/// Equal errors of one key that are listed once.
const REPEATED_MIN: usize = 3;

/// Joins equal errors of one key, such as the same unknown key in every motor.
fn without_repetitions(errors: Vec<Problem>) -> Vec<Problem> {
    let key = |problem: &Problem| {
        let key = problem.location.as_ref().and_then(|location| location.key.clone());
        (key, problem.wrong.to_string())
    };
    let mut lines: HashMap<_, Vec<usize>> = HashMap::new();
    for problem in &errors {
        lines
            .entry(key(problem))
            .or_default()
            .extend(problem.location.as_ref().map(|location| location.line));
    }
    let joined = |mut problem: Problem| {
        let lines = lines.get(&key(&problem)).filter(|lines| lines.len() >= REPEATED_MIN);
        let Some(lines) = lines else { return Some(problem) };
        let count = lines.len();
        if problem.location.as_ref().map(|location| location.line) != lines.first().copied() {
            return None;
        }
        let others: Vec<_> = lines[1..].iter().take(3).map(ToString::to_string).collect();
        let more = count - 1 - others.len();
        let mut others = others.join(", ");
        if more > 0 {
            others += &format!(" and {more} more");
        }
        problem.wrong = Wrong::Repeated { wrong: Box::new(problem.wrong), count, lines: others };
        Some(problem)
    };
    errors.into_iter().filter_map(joined).collect()
}

/// `motor.limits.kp-max`.
fn path(section: &str, key: &str) -> String {
    match (section, key) {
        (name, "") | ("", name) => name.to_owned(),
        (section, key) => format!("{section}.{key}"),
    }
}
