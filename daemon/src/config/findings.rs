//! What was found so far, and the judgements that every section makes.

use std::collections::HashSet;

use motord_bus::Duration;
use motord_shared::limits::NAME_BYTES_MAX;
use toml::Spanned;

use super::Machine;
use super::problem::{Problem, Wrong};
use super::range::Range;
use super::source::{Source, Span, WHOLE};
use super::written::{Integer, Number};

/// Errors and warnings, by the time they were found.
pub(super) struct Findings<'a> {
    source: &'a Source<'a>,
    machine: &'a Machine,
    errors: Vec<Problem>,
    warnings: Vec<Problem>,
}

impl<'a> Findings<'a> {
    pub(super) fn new(source: &'a Source<'a>, machine: &'a Machine) -> Self {
        Self { source, machine, errors: Vec::new(), warnings: Vec::new() }
    }

    /// Errors and warnings.
    pub(super) fn into_problems(self) -> (Vec<Problem>, Vec<Problem>) {
        (self.errors, self.warnings)
    }

    pub(super) fn error(&mut self, place: Span, wrong: Wrong) {
        self.errors.push(self.source.problem(&place, None, wrong));
    }

    pub(super) fn warn(&mut self, place: Span, wrong: Wrong) {
        self.warnings.push(self.source.problem(&place, None, wrong));
    }

    /// What is written, or the report that `key` of the table at `table` is missing.
    pub(super) fn required<'w, T>(
        &mut self,
        written: &'w Option<T>,
        table: &Span,
        key: &str,
        hint: &'static str,
    ) -> Option<&'w T> {
        if written.is_none() {
            self.missing(table, key, hint);
        }
        written.as_ref()
    }

    /// `key` is missing in the table at `table`.
    fn missing(&mut self, table: &Span, key: &str, hint: &'static str) {
        self.errors.push(self.source.problem(table, Some(key), Wrong::Missing(hint)));
    }

    /// Whether there is a table `[[key]]`, and not more than `max` of them.
    pub(super) fn counted<T>(&mut self, tables: &[Spanned<T>], key: &str, max: usize) -> bool {
        if tables.is_empty() {
            self.missing(&WHOLE, key, "motord needs at least one");
        }
        if let Some(beyond) = tables.get(max) {
            self.error(beyond.span(), Wrong::TooMany { max });
        }
        (1..=max).contains(&tables.len())
    }

    /// Whether no text equals an earlier one; reports every one that does.
    pub(super) fn unique<'w>(
        &mut self,
        texts: impl Iterator<Item = Option<&'w Spanned<String>>>,
        wrong: impl Fn(String) -> Wrong,
    ) -> bool {
        let mut seen = HashSet::new();
        let repeated: Vec<_> = texts.flatten().filter(|text| !seen.insert(text.get_ref())).collect();
        for text in &repeated {
            self.error(text.span(), wrong(text.get_ref().clone()));
        }
        repeated.is_empty()
    }

    /// The number, when it is in `range`; else its default.
    pub(super) fn number(&mut self, written: &Number, range: Range) -> f64 {
        let number =
            written.as_ref().and_then(|number| self.in_range(*number.get_ref(), number.span(), range));
        number.unwrap_or(range.default)
    }

    /// The integer, when it is in `range`; else its default. No range leaves what an `f64` holds exactly.
    pub(super) fn integer(&mut self, written: &Integer, range: Range) -> i64 {
        let number =
            written.as_ref().and_then(|number| self.in_range(*number.get_ref() as f64, number.span(), range));
        number.unwrap_or(range.default) as i64
    }

    /// `value`, when it is in `range`.
    pub(super) fn in_range(&mut self, value: f64, place: Span, range: Range) -> Option<f64> {
        let Range { min, max, .. } = range;
        if (min..=max).contains(&value) {
            return Some(value);
        }
        let wrong = match value.is_finite() {
            true => Wrong::OutOfRange { value, min, max },
            false => Wrong::NotFinite { value, min, max },
        };
        self.error(place, wrong);
        None
    }

    /// The name, when it can be one.
    pub(super) fn name(&mut self, written: &Spanned<String>) -> Option<String> {
        let name = written.get_ref();
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if !name.is_empty() && name.len() <= NAME_BYTES_MAX && name.chars().all(is_plain) {
            return Some(name.clone());
        }
        self.error(written.span(), Wrong::Name { name: name.chars().take(NAME_BYTES_MAX).collect() });
        None
    }

    pub(super) fn processor(&mut self, written: &Integer) -> Option<usize> {
        let written = written.as_ref()?;
        let cpu = *written.get_ref();
        let allowed = &self.machine.processors;
        let found = allowed.iter().copied().find(|&one| i64::try_from(one) == Ok(cpu));
        if found.is_none() {
            let allowed = allowed.clone();
            self.error(written.span(), Wrong::Processor { cpu, allowed });
        }
        found
    }

    /// Without `require-realtime` a lower priority is the daemon's to report, and the configuration's to warn of.
    pub(super) fn judge_priority(&mut self, place: Option<Span>, priority: u8, require_realtime: bool) {
        let allowed = self.machine.priority_max;
        match place {
            Some(place) if priority > allowed && require_realtime => {
                self.error(place, Wrong::Priority { priority, allowed });
            }
            Some(place) if priority > allowed => self.warn(place, Wrong::Priority { priority, allowed }),
            _ => {}
        }
    }

    pub(super) fn two_cycles(&mut self, written: &Number, value_ms: f64, period: Duration) {
        let period_ms = 1e3 * period.as_secs_f64();
        if let Some(written) = written
            && value_ms < 2.0 * period_ms
        {
            self.error(written.span(), Wrong::LessThanTwoCycles { value_ms, period_ms });
        }
    }

    pub(super) fn within_cycle(&mut self, written: &Number, value: Duration, period: Duration) {
        if let Some(written) = written
            && value >= period
        {
            let [value_us, period_us] = [value, period].map(|time| 1e6 * time.as_secs_f64());
            self.error(written.span(), Wrong::NotWithinCycle { value_us, period_us });
        }
    }
}
