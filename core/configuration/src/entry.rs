//! One key: the rule by which it is read, and its value in a file.

use std::f64::consts::TAU;
use std::fmt::Display;

use toml::Spanned;
use toml::de::DeValue;

use super::problem::Wrong;
use super::sort::{Sort, cure, found};
use super::units::Shown;
use super::value::{Misfit, Value};

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

/// The advice in the error when a key is missing.
#[derive(Debug, Clone, Copy)]
pub(super) enum Advice {
    /// This text.
    Text(&'static str),
    /// To give one of the choices.
    Choices,
}

/// Default and range of a key.
#[derive(Debug)]
pub(super) struct Rule<T> {
    /// The value when the key is not written.
    pub(super) default: T,
    /// The default in words; `None`: `default` itself.
    default_words: Option<&'static str>,
    /// The advice in the error when the key is missing; `None` where the key may be missing.
    pub(super) required: Option<Advice>,
    /// Both ends are allowed.
    min: f64,
    max: f64,
    /// The range in words; `None`: the numbers or choices themselves.
    range_words: Option<&'static str>,
    /// An angle, rarely more than a turn.
    is_angle: bool,
    /// The advice in the error about a negative number.
    negative: Option<&'static str>,
    /// Words after "write" in the error about a value of another sort.
    advice: Option<&'static str>,
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
        advice: None,
    }
}

/// A key without a fixed default; `words` describe the value without it.
pub(super) fn follows<T>(words: &'static str) -> Rule<Option<T>> {
    Rule { default_words: Some(words), ..is(None) }
}

/// A key that must be written; `hint` says what to write.
pub(super) fn required<T>(hint: &'static str) -> Rule<Option<T>> {
    Rule { required: Some(Advice::Text(hint)), ..follows("required") }
}

/// A key that must be written, with one of its choices.
pub(super) fn required_choice<T>() -> Rule<Option<T>> {
    Rule { required: Some(Advice::Choices), ..follows("required") }
}

impl Advice {
    /// Returns the text for a key whose values are of type `T`.
    pub(super) fn text<T: Value>(self) -> String {
        match self {
            Self::Text(text) => text.to_owned(),
            Self::Choices => match &T::choices()[..] {
                [firsts @ .., last] if !firsts.is_empty() => format!("give {} or {last}", firsts.join(", ")),
                choices => format!("give {}", choices.concat()),
            },
        }
    }
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

    /// Says what to write in place of a value of another sort.
    pub(super) fn instead_of_words(self, advice: &'static str) -> Self {
        Self { advice: Some(advice), ..self }
    }

    /// Reads the value of a key, or returns the reason why it is invalid.
    pub(super) fn read(&self, key: &str, written: Written<'_>, unit: &'static str) -> Result<T, Wrong> {
        let value = T::read(written.value).map_err(|misfit| match misfit {
            Misfit::Value(wrong) => wrong,
            Misfit::Sort => Wrong::Type {
                expected: self.expected_sort(unit).into(),
                found: found(written.value.get_ref(), written.source).into(),
                cure: self.instead(key, written, unit).into(),
            },
        })?;
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

    /// `a number from 1 to 10000 Hz`, or the choices.
    fn expected_sort(&self, unit: &str) -> String {
        let choices: Vec<_> = T::choices().iter().map(|word| format!("{word:?}")).collect();
        match (choices.is_empty(), self.min.is_finite()) {
            (false, _) => format!("one of {}", choices.join(", ")),
            (true, true) => format!("{} {}", T::SORT.name(), self.expected(unit)),
            (true, false) => T::SORT.name().to_owned(),
        }
    }

    fn instead(&self, key: &str, Written { value, source }: Written<'_>, unit: &str) -> String {
        // A choice is none of the texts that a number could be.
        let sort = if T::choices().is_empty() { Some(T::SORT) } else { None };
        let example = self.example();
        match sort {
            Some(sort) => sort
                .converted(value.get_ref(), source, unit)
                .map(|(value, how)| cure(key, &value, how))
                .or_else(|| sort.foreign(value.get_ref().as_str()?, unit, (key, &example)))
                .unwrap_or_else(|| format!("write {}, such as {key} = {example}", self.to_write())),
            None => format!("write a text, such as {key} = {example}"),
        }
    }

    /// The expected value, after "write".
    fn to_write(&self) -> &'static str {
        self.advice.unwrap_or_else(|| T::SORT.to_write())
    }

    /// The default, or another value, as it is written in a file.
    fn example(&self) -> String {
        match T::choices().first() {
            Some(word) => format!("{word:?}"),
            None if self.default.default_text().is_empty() => T::SORT.example().to_owned(),
            None => self.default.default_text(),
        }
    }

    /// Returns the warning for a valid value, if any.
    pub(super) fn warning(&self, value: &T) -> Option<Wrong> {
        if let Some(wrong) = value.warning() {
            return Some(wrong);
        }
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
        true => format!("; is it in degrees? {}° is {:.4} rad", Shown(value), value.to_radians()),
        false => String::new(),
    }
}

/// A value as it is written.
#[derive(Clone, Copy)]
pub(super) struct Written<'w> {
    pub(super) value: &'w Spanned<DeValue<'w>>,
    /// Its part of the file.
    pub(super) source: &'w str,
}

/// A row of the reference. The texts are Markdown.
#[derive(Debug)]
pub(super) struct Row {
    cells: [String; 6],
    /// The sort of its values.
    pub(super) sort: Sort,
    /// The expected value, after "write".
    pub(super) to_write: &'static str,
    /// The expected value, for messages.
    pub(super) expected: String,
    /// A value, as it is written in a file.
    pub(super) example: String,
}

impl Row {
    /// Headings of the columns.
    pub(super) const HEAD: [&'static str; 6] = ["key", "type", "unit", "default", "range", "meaning"];

    pub(super) fn new<T: Value>(key: &str, unit: &str, rule: Rule<T>, meaning: &str) -> Self {
        let default = rule.default_words.map_or_else(|| rule.default.default_text(), str::to_owned);
        let kind = T::SORT.name().trim_start_matches("an ").trim_start_matches("a ").to_owned();
        let cells = [code(key), kind, unit.to_owned(), default, rule.range(), meaning.to_owned()];
        Self {
            cells,
            sort: T::SORT,
            to_write: rule.to_write(),
            expected: rule.expected_sort(unit),
            example: rule.example(),
        }
    }

    pub(super) fn unit(&self) -> &str {
        &self.cells[2]
    }

    pub(super) fn into_cells(self) -> [String; 6] {
        self.cells
    }
}

fn code(text: impl Display) -> String {
    format!("`{text}`")
}
