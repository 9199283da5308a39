//! Explains text that is no TOML: its place and key, what was expected, and what to write.
//!
//! The TOML library reports a place, and a few words for people who know TOML. The explanations
//! here look at the line itself.

mod line;
mod scan;
mod value;

use toml::de::Error;

use super::keys::{self, SECTIONS};
use super::problem::{Wrong, plain};
use super::sort::quoted;
use super::table::is_list;
use line::Line;

/// A mistake in the text.
pub(super) struct Mistake {
    /// Bytes from the start of the file.
    pub(super) offset: usize,
    /// The dotted key, where the line has one.
    pub(super) key: Option<String>,
    pub(super) wrong: Wrong,
}

/// Explains the first of `errors`, which the TOML library reported of `text`. `None` without one.
pub(super) fn explain(text: &str, errors: &[Error]) -> Option<Mistake> {
    let start = |error: &&Error| error.span().unwrap_or_default().start;
    let error = errors.iter().min_by_key(start)?;
    let of_file = |offset, wrong| Mistake { offset, key: None, wrong };
    Some(match (other_format(text), lone_return(text)) {
        (Some(format), _) => of_file(0, Wrong::OtherFormat(format)),
        (None, Some(offset)) => of_file(offset, Wrong::LoneReturn),
        (None, None) => mistake(text, error),
    })
}

fn mistake(text: &str, error: &Error) -> Mistake {
    let span = error.span().unwrap_or_default();
    let excerpt = text.get(span.clone()).unwrap_or_default();
    let line = Line::at(text, span.start);
    if error.message() == "duplicate key" {
        if let Some(mistake) = table_before_list(text, span.start, excerpt) {
            return mistake;
        }
        return Mistake { offset: span.start, key: line.path(), wrong: duplicate(text, span.start, excerpt) };
    }
    if let Some(open) = scan::unclosed_text(text).filter(|open| *open <= span.start) {
        return Mistake {
            offset: open,
            key: Line::at(text, open).path(),
            wrong: Wrong::Toml(text_without_end(text, open)),
        };
    }
    if let Some(open) = scan::unclosed(text, span.start) {
        let (line, bracket) = (Line::at(text, open), if text[open..].starts_with('{') { "{" } else { "[" });
        let close = if bracket == "{" { "}" } else { "]" };
        return Mistake { offset: open, key: line.path(), wrong: Wrong::Unclosed { bracket, close } };
    }
    let row = line.key.and_then(|key| keys::row(&line.section(), key));
    let explained = value::explain(&line, row.as_ref(), error.message());
    let wrong =
        explained.map_or_else(|| Wrong::toml(error.message(), excerpt), |text| Wrong::Toml(plain(&text)));
    Mistake { offset: span.start, key: line.path(), wrong }
}

/// A quote of a text of several lines that has no end.
fn text_without_end(text: &str, open: usize) -> String {
    let (marks, line) = (&text[open..open + 3], text[open..].lines().next().unwrap_or_default());
    let key = Line::at(text, open).key.unwrap_or("KEY");
    let value = quoted(line.trim_matches(['"', '\'']));
    format!("the text after `{marks}` has no end; write {key} = \"{value}\"")
}

/// `[motor.limits]` before the first `[[motor]]`, which the TOML library then calls a duplicate.
fn table_before_list(text: &str, offset: usize, name: &str) -> Option<Mistake> {
    let begin = text[..offset].rfind('\n').map_or(0, |end| end + 1);
    let list = format!("[[{name}]]");
    let begins_item = |line: &str| line.trim_start().starts_with(&list);
    if !is_list(SECTIONS, name) || !begins_item(&text[begin..]) || text[..begin].lines().any(begins_item) {
        return None;
    }
    let mut at = 0;
    let below = format!("[{name}.");
    let line = text[..begin].split_inclusive('\n').find(|line| {
        at += line.len();
        line.trim_start().starts_with(&below)
    })?;
    let wrong =
        Wrong::Toml(format!("is before the first {list}; move it below the {list} that it belongs to"));
    let offset = at - line.trim_start().len();
    Some(Mistake { offset, key: Line::at(text, offset).path(), wrong })
}

/// A key or a table that is there a second time at `offset`.
fn duplicate(text: &str, offset: usize, name: &str) -> Wrong {
    let first =
        scan::earlier(text, offset, name).map_or_else(String::new, |line| format!(", first in line {line}"));
    Wrong::Toml(match is_list(SECTIONS, name) {
        true => format!("is there twice{first}; write `[[{name}]]`, with two brackets, each time"),
        false => format!("`{}` is there twice{first}; keep one", quoted(name)),
    })
}

/// Returns the offset of the first carriage return without a line feed.
fn lone_return(text: &str) -> Option<usize> {
    let is_lone = |(offset, _): &(usize, &str)| text.as_bytes().get(offset + 1) != Some(&b'\n');
    text.match_indices('\r').find(is_lone).map(|(offset, _)| offset)
}

/// Returns the name of another format that the text is written in.
fn other_format(text: &str) -> Option<&'static str> {
    let text = text.trim_start_matches('\u{feff}').trim_start();
    let in_bracket = text.strip_prefix('[').map(str::trim_start);
    let begins = |text: &str, one_of: &[char]| text.starts_with(one_of);
    match text {
        text if text.starts_with("---") || text.starts_with("%YAML") => Some("YAML"),
        text if begins(text, &['{']) || in_bracket.is_some_and(|rest| begins(rest, &['{', '"'])) => {
            Some("JSON")
        }
        text if begins(text, &['<']) && !text.starts_with("<<<<") => Some("XML"),
        _ => None,
    }
}
