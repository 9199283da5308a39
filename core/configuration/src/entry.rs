//! One key: the rule by which it is read, and its value in a file.

use std::f64::consts::TAU;
use std::fmt::Display;

use toml::Spanned;
use toml::de::DeValue;

use super::problem::Wrong;
use super::value::Value;

/// A place in the file, for reports of problems.
#[derive(Debug, Clone, Copy)]
pub(super) struct At {
    /// Bytes from the start of the file.
    pub(super) offset: usize,
    /// The path of the table, as it is written.
    pub(super) section: &'static str,
    /// The key; empty for the table as a whole.
    pub(super) key: &'static str,
}

/// A key as it was read.
#[derive(Debug, Clone)]
pub(super) struct Entry<T> {
    /// The written value, if it is valid; otherwise the default.
    pub(super) value: T,
    /// The place of the value; that of its table, if the value is not written.
    pub(super) at: At,
    /// The unit of the value, where it has one.
    pub(super) unit: &'static str,
    /// The key is in the file, with a valid value or not.
    pub(super) is_written: bool,
}

/// An item of a `[[list]]`, and where it begins.
pub(super) struct Item<T> {
    pub(super) at: At,
    pub(super) keys: T,
}

/// Default and range of a key.
#[derive(Debug)]
pub(super) struct Rule<T> {
    /// The value when the key is not written.
    pub(super) default: T,
    /// The default in words; `None`: `default` itself.
    default_words: Option<&'static str>,
    /// The advice in the error when the key is missing; `None` where the key may be missing.
    pub(super) required: Option<&'static str>,
    /// Both ends are allowed.
    min: f64,
    max: f64,
    /// The range in words; `None`: the numbers or choices themselves.
    range_words: Option<&'static str>,
    /// An angle, rarely more than a turn.
    is_angle: bool,
    /// The advice in the error about a negative number.
    negative: Option<&'static str>,
}

/// A key with a default.
pub(super) fn is<T>(default: T) -> Rule<T> {
    Rule {
        default,
        default_words: None,
        required: None,
        min: f64::NEG_INFINITY,
        max: f64::INFINITY,
        range_words: None,
        is_angle: false,
        negative: None,
    }
}

/// A key without a fixed default; `words` describe the value without it.
pub(super) fn follows<T>(words: &'static str) -> Rule<Option<T>> {
    Rule { default_words: Some(words), ..is(None) }
}

/// A key that must be written; `hint` says what to write.
pub(super) fn required<T>(hint: &'static str) -> Rule<Option<T>> {
    Rule { required: Some(hint), ..follows("required") }
}

impl<T: Value> Rule<T> {
    pub(super) fn within(self, min: f64, max: f64) -> Self {
        Self { min, max, ..self }
    }

    pub(super) fn at_least(self, min: f64) -> Self {
        Self { min, ..self }
    }

    /// Describes the range in words, where two numbers cannot.
    pub(super) fn words(self, words: &'static str) -> Self {
        Self { range_words: Some(words), ..self }
    }

    /// Warns beyond a turn, where degrees may be meant.
    pub(super) fn angle(self) -> Self {
        Self { is_angle: true, ..self }
    }

    /// Advises what to write instead of a negative number.
    pub(super) fn if_negative(self, hint: &'static str) -> Self {
        Self { negative: Some(hint), ..self }
    }

    /// Reads the value, or returns the reason why it is invalid.
    pub(super) fn read(&self, written: &Spanned<DeValue<'_>>, unit: &'static str) -> Result<T, Wrong> {
        let value = T::read(written)?;
        match value.number() {
            Some(number) if !number.is_finite() => {
                Err(Wrong::NotFinite { value: number, expected: self.expected(unit) })
            }
            Some(number) if !(self.min..=self.max).contains(&number) => {
                let hint = match self.negative {
                    Some(hint) if number < 0.0 => format!("; {hint}"),
                    _ if unit == "rad" => degrees(number),
                    _ => String::new(),
                };
                Err(Wrong::OutOfRange { value: number, expected: self.expected(unit), hint })
            }
            _ => Ok(value),
        }
    }

    /// Returns the warning for a valid value, if any.
    pub(super) fn doubt(&self, value: &T) -> Option<Wrong> {
        let number = value.number().filter(|number| self.is_angle && number.abs() > TAU)?;
        Some(Wrong::ManyTurns { value: number, degrees: degrees(number) })
    }

    /// `from 1 to 10000 Hz`.
    fn expected(&self, unit: &str) -> String {
        let space = if unit.is_empty() { "" } else { " " };
        match self.max.is_finite() {
            true => format!("from {} to {}{space}{unit}", self.min, self.max),
            false => format!("of at least {}{space}{unit}", self.min),
        }
    }

    fn range(&self) -> String {
        match (self.range_words, self.min.is_finite(), self.max.is_finite()) {
            (Some(words), ..) => words.to_owned(),
            (None, true, true) => format!("{} to {}", self.min, self.max),
            (None, true, false) => format!("at least {}", self.min),
            _ => T::choices().iter().map(code).collect::<Vec<_>>().join(", "),
        }
    }
}

/// Returns the hint for an angle beyond a turn; empty for others.
pub(super) fn degrees(value: f64) -> String {
    match value.is_finite() && value.abs() > TAU {
        true => format!("; is it in degrees? {value}° is {:.4} rad", value.to_radians()),
        false => String::new(),
    }
}

/// A row of the reference. The texts are Markdown.
#[derive(Debug)]
pub(super) struct Row {
    cells: [String; 6],
}

impl Row {
    /// Headings of the columns.
    pub(super) const HEAD: [&'static str; 6] = ["key", "type", "unit", "default", "range", "meaning"];

    pub(super) fn new<T: Value>(key: &str, unit: &str, rule: Rule<T>, meaning: &str) -> Self {
        let default = rule.default_words.map_or_else(|| rule.default.default_text(), str::to_owned);
        let kind = T::KIND.trim_start_matches("an ").trim_start_matches("a ").to_owned();
        let cells = [code(key), kind, unit.to_owned(), default, rule.range(), meaning.to_owned()];
        Self { cells }
    }

    pub(super) fn into_cells(self) -> [String; 6] {
        self.cells
    }
}

fn code(text: impl Display) -> String {
    format!("`{text}`")
}
