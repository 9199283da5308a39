//! The line of a mistake: its table, its key and its value.

use super::super::problem::plain;
use super::scan::{is_key, open_at};

/// A line of a file that is no TOML.
pub(super) struct Line<'t> {
    /// Without its comment and the spaces at its ends.
    pub(super) text: &'t str,
    /// The text from the mistake to the end of the line.
    pub(super) rest: &'t str,
    /// The name of the table that the line is in.
    table: &'t str,
    /// The key of the table in braces around the mistake.
    outer: Option<&'t str>,
    /// The key whose value has the mistake.
    pub(super) key: Option<&'t str>,
    /// The text after the key's `=`.
    pub(super) value: Option<&'t str>,
    /// Another key follows the value, without a comma before it.
    pub(super) lacks_comma: bool,
    /// The line is a part of a list or of braces that began in an earlier line.
    pub(super) is_inside: bool,
}

impl<'t> Line<'t> {
    /// Returns the line with the byte at `offset`.
    pub(super) fn at(text: &'t str, offset: usize) -> Self {
        let begin = text[..offset].rfind('\n').map_or(0, |end| end + 1);
        let end = text[offset..].find('\n').map_or(text.len(), |end| offset + end);
        let whole = without_comment(&text[begin..end]);
        let opened = open_at(text, begin);
        // The line that an open list or table began in has the key.
        let (from, to) = match opened {
            Some(open) => {
                let begin = text[..open].rfind('\n').map_or(0, |end| end + 1);
                (begin, text[open..].find('\n').map_or(text.len(), |end| open + end))
            }
            None => (begin, begin + whole.len()),
        };
        let mut line = Self {
            text: whole.trim(),
            rest: text[offset..end].trim_end(),
            table: table_before(text, begin),
            outer: None,
            key: None,
            value: None,
            lacks_comma: false,
            is_inside: opened.is_some(),
        };
        line.find_key(&text[from..to.max(from)], offset.saturating_sub(from));
        line
    }

    /// Finds the key, and the one around it, in a line with the mistake at byte `at`.
    fn find_key(&mut self, line: &'t str, at: usize) {
        let Some((key, value)) = line.split_once('=') else { return };
        let key = key.trim();
        if !is_key(key) {
            return;
        }
        (self.key, self.value) = (Some(key), Some(value.trim()));
        let (Some(brace), Some(equals)) = (value.find('{'), line.find('=')) else { return };
        let inside = &value[brace + 1..];
        let inside_at = equals + 1 + brace + 1;
        if at < inside_at {
            return;
        }
        let (outer, reached) = (key, at - inside_at);
        if let Some(Inner { key, value, lacks_comma }) = inner_key(inside, reached) {
            (self.outer, self.key, self.value) = (Some(outer), Some(key), Some(value));
            self.lacks_comma = lacks_comma;
        }
    }

    /// The table of the key: `motor.limits`.
    pub(super) fn section(&self) -> String {
        let table = if self.table == "exchange" { "ipc" } else { self.table };
        match self.outer {
            Some(outer) => format!("{table}.{outer}"),
            None => table.to_owned(),
        }
    }

    /// The dotted key: `motor.limits.kp-max`; the table where the line has no key.
    pub(super) fn path(&self) -> Option<String> {
        if self.text.starts_with('[') {
            let name = self.text.trim_matches(['[', ']', ' ']);
            return is_key(name).then(|| name.to_owned());
        }
        let key = self.key.or_else(|| {
            self.text.split([':', ' ', '\t']).next().filter(|word| is_word_of_key(word, self.text))
        });
        let parts = [Some(self.table), self.outer, key];
        let parts: Vec<_> = parts.into_iter().flatten().filter(|part| !part.is_empty()).collect();
        (!parts.is_empty()).then(|| plain(&parts.join(".")))
    }
}

/// The first word of a line without `=` is a key if a colon or a value follows it.
fn is_word_of_key(word: &str, line: &str) -> bool {
    is_key(word) && word.len() < line.len()
}

/// A key in braces, and its value up to the next key.
struct Inner<'t> {
    key: &'t str,
    value: &'t str,
    lacks_comma: bool,
}

/// Returns the last key before byte `reached` of the text in braces.
fn inner_key(inside: &str, reached: usize) -> Option<Inner<'_>> {
    let keys: Vec<(usize, usize)> = inside
        .match_indices('=')
        .filter_map(|(equals, _)| {
            let name = inside[..equals].trim_end();
            let begin = name.rfind(|letter: char| !is_key(&letter.to_string())).map_or(0, |last| last + 1);
            // A byte after the last letter of another kind is a boundary only for ASCII.
            let begin = (begin..=name.len()).find(|at| name.is_char_boundary(*at))?;
            (begin < name.len()).then_some((begin, equals))
        })
        .collect();
    let index = keys.iter().rposition(|(begin, _)| *begin <= reached).unwrap_or(0);
    let (begin, equals) = *keys.get(index)?;
    let end = keys.get(index + 1).map_or(inside.len(), |(next, _)| *next);
    let value = inside[equals + 1..end].trim();
    let lacks_comma = end < inside.len() && !value.ends_with(',');
    let value = value.trim_end_matches('}').trim_end().trim_end_matches(',').trim_end();
    Some(Inner { key: inside[begin..equals].trim(), value, lacks_comma })
}

/// Returns the name of the table that the last header before `begin` has; empty without one.
fn table_before(text: &str, begin: usize) -> &str {
    let header = text[..begin].lines().rfind(|line| line.trim_start().starts_with('['));
    let name = header.map(|line| line.trim().trim_start_matches('[').split(']').next().unwrap_or_default());
    name.map(str::trim).filter(|name| is_key(name)).unwrap_or_default()
}

/// Cuts a comment off.
fn without_comment(line: &str) -> &str {
    let mut quote = None;
    for (at, letter) in line.char_indices() {
        match (quote, letter) {
            (Some(begun), letter) if letter == begun => quote = None,
            (None, '"' | '\'') => quote = Some(letter),
            (None, '#') => return &line[..at],
            _ => {}
        }
    }
    line
}
