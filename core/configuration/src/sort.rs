//! The sorts of values, and what to write in place of a value of another sort.

use toml::de::DeValue;

use super::problem::plain;
use super::units::{Reading, Unit, reading};

/// Letters of a value that a message quotes.
const QUOTED_MAX: usize = 40;

/// A sort of values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sort {
    Number,
    Integer,
    Flag,
    Text,
    TwoNumbers,
    ThreeNumbers,
    Texts,
}

impl Sort {
    /// Its name, with an article.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Number => "a number",
            Self::Integer => "an integer",
            Self::Flag => "true or false",
            Self::Text => "a text",
            Self::TwoNumbers => "a list of two numbers",
            Self::ThreeNumbers => "a list of three numbers",
            Self::Texts => "a list of texts",
        }
    }

    /// The name after "write".
    pub(super) const fn to_write(self) -> &'static str {
        match self {
            Self::TwoNumbers => "two numbers",
            Self::ThreeNumbers => "three numbers",
            Self::Texts => "texts",
            other => other.name(),
        }
    }

    /// A value, as it is written in a file.
    pub(super) const fn example(self) -> &'static str {
        match self {
            Self::Number => "1.5",
            Self::Integer => "1",
            Self::Flag => "true",
            Self::Text => "\"hip\"",
            Self::TwoNumbers => "[-0.5, 0.5]",
            Self::ThreeNumbers => "[0, 0, 90]",
            Self::Texts => "[\"hip\", \"knee\"]",
        }
    }

    /// Returns the value of this sort that was probably meant, and how it differs.
    pub(super) fn converted(
        self,
        value: &DeValue<'_>,
        source: &str,
        unit: &str,
    ) -> Option<(String, &'static str)> {
        const NO_QUOTES: &str = "without quotes";
        match (self, value) {
            (Self::Number | Self::Integer, DeValue::String(text)) => {
                match reading(text, unit, self == Self::Integer) {
                    Reading::Number(number) => Some((number, NO_QUOTES)),
                    _ => None,
                }
            }
            (Self::Integer, DeValue::Float(_)) => {
                let float: f64 = source.parse().ok()?;
                (float.fract() == 0.0 && float.abs() < 1e15)
                    .then(|| (format!("{float:.0}"), "without a point"))
            }
            (Self::Flag, DeValue::String(text)) => Some((flag(text)?.to_string(), NO_QUOTES)),
            (Self::Flag, DeValue::Integer(_)) => Some((flag(source)?.to_string(), "")),
            (Self::Text, DeValue::Integer(_) | DeValue::Float(_)) => {
                Some((format!("\"{}\"", plain(source)), "with quotes"))
            }
            (Self::TwoNumbers, DeValue::Integer(_) | DeValue::Float(_)) => {
                let end = source.trim_start_matches(['-', '+']);
                Some((format!("[-{end}, {end}]"), ""))
            }
            (Self::Texts, DeValue::String(text)) => {
                let texts: Vec<_> = text.split(',').map(|text| format!("{:?}", text.trim())).collect();
                Some((format!("[{}]", texts.join(", ")), ""))
            }
            (_, DeValue::Array(items)) if items.len() == 1 && self.is(items.first()?.get_ref()) => {
                let inner = source.strip_prefix('[')?.strip_suffix(']')?.trim().trim_end_matches(',');
                Some((plain(inner), "without brackets"))
            }
            _ => None,
        }
    }

    /// Explains a text whose unit is not one of the key; `None` for one that begins with no number.
    /// Proposes no number of it: in the unit of the key it is another value.
    pub(super) fn foreign(self, text: &str, unit: &str, (key, example): (&str, &str)) -> Option<String> {
        if !matches!(self, Self::Number | Self::Integer) {
            return None;
        }
        let Reading::Foreign(rest) = reading(text, unit, self == Self::Integer) else { return None };
        let rest = quoted(&rest);
        let (what, write) = match Unit::of_key(unit) {
            Some(own) => (format!("unit of {}", own.quantity()), format!("a number in {unit}")),
            None => ("part of a number".to_owned(), self.to_write().to_owned()),
        };
        Some(format!("`{rest}` is no {what}; write {write}, such as {key} = {example}"))
    }

    fn is(self, value: &DeValue<'_>) -> bool {
        match self {
            Self::Number => matches!(value, DeValue::Integer(_) | DeValue::Float(_)),
            Self::Integer => matches!(value, DeValue::Integer(_)),
            Self::Flag => matches!(value, DeValue::Boolean(_)),
            Self::Text => matches!(value, DeValue::String(_)),
            Self::TwoNumbers | Self::ThreeNumbers | Self::Texts => false,
        }
    }
}

/// The line to write for `key`, and how it differs.
pub(super) fn cure(key: &str, value: &str, how: &str) -> String {
    let comma = if how.is_empty() { "" } else { ", " };
    format!("write {key} = {value}{comma}{how}")
}

/// Returns the value of the words that people use for true and false.
pub(super) fn flag(text: &str) -> Option<bool> {
    match text.trim().to_lowercase().as_str() {
        "true" | "yes" | "on" | "1" => Some(true),
        "false" | "no" | "off" | "0" => Some(false),
        _ => None,
    }
}

/// Describes a value that is `source` in the file: `the text "1000"`.
pub(super) fn found(value: &DeValue<'_>, source: &str) -> String {
    let quoted = quoted(source);
    match value {
        DeValue::String(_) => format!("the text {quoted}"),
        DeValue::Integer(_) => format!("the integer {quoted}"),
        DeValue::Float(_) => format!("the number {quoted}"),
        DeValue::Boolean(_) => quoted,
        DeValue::Datetime(_) => format!("the date {quoted}"),
        DeValue::Array(_) => format!("the list {quoted}"),
        DeValue::Table(_) => format!("the table {quoted}"),
    }
}

/// The first line of a part of a file, cut where it is long.
pub(super) fn quoted(source: &str) -> String {
    let line = source.trim().lines().next().unwrap_or_default();
    let cut: String = line.chars().take(QUOTED_MAX).collect();
    let rest = if cut.len() < source.trim().len() { "…" } else { "" };
    format!("{}{rest}", plain(&cut))
}
