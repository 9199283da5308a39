//! The text of a configuration, and where in it a value stands.

use std::path::Path;

use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::problem::{Place, Problem, Wrong, escaped};
use super::{ConfigError, written};

/// A range of bytes in the text.
pub(super) type Span = std::ops::Range<usize>;

/// The place of what concerns the file as a whole: its first line, and no key.
pub(super) const WHOLE: Span = 0..0;

/// A file whose text is TOML.
pub(super) struct Source<'a> {
    file: &'a Path,
    text: &'a str,
    table: Spanned<DeTable<'a>>,
}

impl<'a> Source<'a> {
    /// Reports the first error of syntax: those behind it mostly follow from it.
    pub(super) fn new(file: &'a Path, text: &'a str) -> Result<Self, ConfigError> {
        let source = Self { file, text, table: Spanned::new(WHOLE, DeTable::new()) };
        match DeTable::parse(text) {
            Ok(table) => Ok(Self { table, ..source }),
            Err(error) => Err(source.refusal(&error)),
        }
    }

    /// The text as keys and values of the right types. The first key that is unknown or of a wrong type ends it.
    pub(super) fn document(&self) -> Result<written::Document, ConfigError> {
        let deserializer = toml::Deserializer::from(self.table.clone());
        written::Document::deserialize(deserializer).map_err(|error| self.refusal(&error))
    }

    /// A problem with what stands at `span`; `missing` is the key that should be there and is not.
    pub(super) fn problem(&self, span: &Span, missing: Option<&str>, wrong: Wrong) -> Problem {
        let mut place = place_of_byte(self.text.as_bytes(), span.start);
        let written = path_to(self.table.get_ref(), span);
        place.key = match (written, missing) {
            (Some(path), Some(missing)) => Some(format!("{path}.{missing}")),
            (path, missing) => path.or(missing.map(str::to_owned)),
        };
        Problem { file: self.file.into(), place: Some(place), wrong }
    }

    fn refusal(&self, error: &toml::de::Error) -> ConfigError {
        let span = error.span().unwrap_or(WHOLE);
        let excerpt = self.text.get(span.clone()).and_then(|text| text.lines().next()).unwrap_or_default();
        ConfigError { problems: vec![self.problem(&span, None, Wrong::toml(error.message(), excerpt))] }
    }
}

/// The line of the byte at `offset`.
pub(super) fn place_of_byte(text: &[u8], offset: usize) -> Place {
    let before = &text[..offset.min(text.len())];
    Place { line: 1 + before.iter().filter(|byte| **byte == b'\n').count(), key: None }
}

/// The dotted key that stands at `span`, or whose value does. Recursion ends where the parser's does, at 80 levels.
fn path_to(table: &DeTable<'_>, span: &Span) -> Option<String> {
    table.iter().find_map(|(key, value)| {
        let name = || key.get_ref().chars().flat_map(escaped).collect::<String>();
        match tables_in(value).find_map(|table| path_to(table, span)) {
            Some(rest) => Some(format!("{}.{rest}", name())),
            None => (covers(&key.span(), span) || value_covers(value, span)).then(name),
        }
    })
}

/// The tables a value is or lists.
fn tables_in<'t, 'a>(value: &'t Spanned<DeValue<'a>>) -> impl Iterator<Item = &'t DeTable<'a>> {
    let own = value.get_ref().as_table();
    let listed = value.get_ref().as_array().into_iter().flatten();
    own.into_iter().chain(listed.filter_map(|item| item.get_ref().as_table()))
}

/// The span of an array of tables is that of its first header only: its items know better.
fn value_covers(value: &Spanned<DeValue<'_>>, span: &Span) -> bool {
    let mut items = value.get_ref().as_array().into_iter().flatten();
    covers(&value.span(), span) || items.any(|item| covers(&item.span(), span))
}

fn covers(outer: &Span, inner: &Span) -> bool {
    !inner.is_empty() && outer.start <= inner.start && inner.end <= outer.end
}
