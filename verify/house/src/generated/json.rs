//! JSON whose objects keep the order of their members.

use serde_json::Value;
use std::fmt::Write;

/// A value.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Json {
    Object(Vec<(String, Self)>),
    Array(Vec<Self>),
    /// A text, number, truth value or null.
    Plain(Value),
}

impl From<&str> for Json {
    fn from(text: &str) -> Self {
        Self::Plain(text.into())
    }
}

impl Json {
    pub(super) const EMPTY: Self = Self::Object(Vec::new());

    /// Reads valid JSON.
    pub(super) fn read(text: &str) -> Self {
        Self::split(text).0
    }

    /// Returns the value at the begin of `text`, and what follows.
    fn split(text: &str) -> (Self, &str) {
        let text = text.trim_start();
        if let Some(rest) = text.strip_prefix('{') {
            let (members, rest) = Self::split_list(rest, '}', |entry| {
                let (key, rest) = Self::split(entry);
                let Self::Plain(Value::String(key)) = key else { panic!("{entry:?} begins with no key") };
                let (value, rest) =
                    Self::split(rest.trim_start().strip_prefix(':').expect("a key has a value"));
                ((key, value), rest)
            });
            return (Self::Object(members), rest);
        }
        if let Some(rest) = text.strip_prefix('[') {
            let (items, rest) = Self::split_list(rest, ']', Self::split);
            return (Self::Array(items), rest);
        }
        let mut values = serde_json::Deserializer::from_str(text).into_iter::<Value>();
        let value = values.next().and_then(Result::ok).expect("a value");
        (Self::Plain(value), &text[values.byte_offset()..])
    }

    fn split_list<'a, E>(
        text: &'a str,
        end: char,
        entry: impl Fn(&'a str) -> (E, &'a str),
    ) -> (Vec<E>, &'a str) {
        let (mut entries, mut rest) = (Vec::new(), text.trim_start());
        loop {
            if let Some(rest) = rest.strip_prefix(end) {
                return (entries, rest);
            }
            let (read, after) = entry(rest);
            entries.push(read);
            let after = after.trim_start();
            rest = after.strip_prefix(',').unwrap_or(after).trim_start();
        }
    }

    /// Returns the text, indented by two spaces.
    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        self.write(&mut text, 0);
        text + "\n"
    }

    fn write(&self, text: &mut String, depth: usize) {
        let entries: Vec<(Option<&String>, &Self)> = match self {
            Self::Object(members) => members.iter().map(|(key, value)| (Some(key), value)).collect(),
            Self::Array(items) => items.iter().map(|item| (None, item)).collect(),
            Self::Plain(value) => return write!(text, "{value}").expect("a text has room"),
        };
        let (begin, end) = if matches!(self, Self::Object(_)) { ('{', '}') } else { ('[', ']') };
        text.push(begin);
        for (index, (key, value)) in entries.iter().enumerate() {
            text.push_str(if index == 0 { "\n" } else { ",\n" });
            text.push_str(&"  ".repeat(depth + 1));
            if let Some(key) = key {
                write!(text, "{}: ", Value::from(key.as_str())).expect("a text has room");
            }
            value.write(text, depth + 1);
        }
        if !entries.is_empty() {
            text.push('\n');
            text.push_str(&"  ".repeat(depth));
        }
        text.push(end);
    }

    /// Returns the member of an object, which it creates at its end where it has none.
    pub(super) fn member(&mut self, key: &str) -> &mut Self {
        let Self::Object(members) = self else { panic!("{key}: in no object") };
        let index = members.iter().position(|(known, _)| known == key).unwrap_or_else(|| {
            members.push((key.to_owned(), Self::EMPTY));
            members.len() - 1
        });
        &mut members[index].1
    }

    /// Returns whether an object has this member.
    pub(super) fn has(&self, key: &str) -> bool {
        matches!(self, Self::Object(members) if members.iter().any(|(known, _)| known == key))
    }

    /// Adds a text to an array that lacks it.
    pub(super) fn add(&mut self, text: &str) {
        let Self::Array(items) = self else { panic!("{text}: in no array") };
        if !items.contains(&text.into()) {
            items.push(text.into());
        }
    }
}
