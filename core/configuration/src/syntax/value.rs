//! The mistake in a line, and what to write.

use super::super::entry::Row;
use super::super::sort::{Sort, flag, quoted};
use super::super::units::{Reading, reading};
use super::line::Line;
use super::scan::is_key;
use motord_untrusted::is_harmless;

/// Quotes of text processors.
const TYPOGRAPHIC: [char; 8] = ['“', '”', '„', '‘', '’', '‚', '«', '»'];

/// Explains a line whose key has `row`; `message` is that of the TOML library. `None`: not known.
pub(super) fn explain(line: &Line<'_>, row: Option<&Row>, message: &str) -> Option<String> {
    if let Some(explained) = of_conflict(line).or_else(|| of_dash(line)).or_else(|| of_letter(line)) {
        return Some(explained);
    }
    if line.is_inside {
        return missing_comma(message);
    }
    match (line.key, line.value) {
        (Some(key), Some(value)) => {
            let is_at_key = line.rest.starts_with(key);
            of_value(&Value { key, text: value, row, message, is_at_key, lacks_comma: line.lacks_comma })
        }
        _ if line.text.starts_with('[') => Some(of_header(line.text)),
        _ => Some(without_equals(line.text)),
    }
}

fn of_conflict(line: &Line<'_>) -> Option<String> {
    let marks = ["<<<<<<<", "=======", ">>>>>>>"];
    let is_mark = marks.iter().any(|mark| line.text.starts_with(mark));
    is_mark.then(|| "is a mark of a merge conflict; choose one side, and delete the marks".to_owned())
}

/// Explains an invisible letter, or one that looks like a space.
fn of_letter(line: &Line<'_>) -> Option<String> {
    let letter = line.rest.chars().next()?;
    let is_seen = letter.is_ascii_graphic()
        || letter == ' '
        || letter.is_alphanumeric()
        || TYPOGRAPHIC.contains(&letter);
    let is_hidden = letter.is_whitespace() || !is_harmless(letter);
    match letter {
        '\t' => None,
        letter if !is_seen && is_hidden => Some(format!(
            "has the invisible character U+{:04X} here; delete it, or write a space",
            u32::from(letter)
        )),
        _ => None,
    }
}

/// Dashes that are no minus of TOML.
const DASHES: [char; 10] = ['‐', '‑', '‒', '–', '—', '―', '−', '﹘', '﹣', '－'];

/// Explains a dash outside a text.
fn of_dash(line: &Line<'_>) -> Option<String> {
    let unquoted = line.rest.split(['"', '\'', '#']).next()?;
    let dash = unquoted.chars().find(|letter| DASHES.contains(letter))?;
    Some(format!("has the dash U+{:04X} here; write `-`", u32::from(dash)))
}

fn missing_comma(message: &str) -> Option<String> {
    let is_missing = message.starts_with("missing comma") || message.starts_with("extra assignment");
    is_missing.then(|| "expected a comma after the item before this one; write one".to_owned())
}

/// A line that begins like a table.
fn of_header(text: &str) -> String {
    let end = text.rfind(']').map_or(text.len(), |end| end + 1);
    let (header, key) = (text[..end].trim(), text[end..].trim());
    if key.contains('=') && is_key(header.trim_matches(['[', ']', ' '])) {
        let (header, key) = (quoted(header), quoted(key));
        return format!(
            "found a table and a key in one line; write {header} in one line, and {key} in the next"
        );
    }
    let name = text.trim_matches(['[', ']', ' ']);
    let header = if text.starts_with("[[") { format!("[[{name}]]") } else { format!("[{name}]") };
    format!(
        "expected a table's name in brackets, found `{}`; write {header}, alone in its line",
        quoted(text)
    )
}

/// A line without `=`.
fn without_equals(text: &str) -> String {
    let (key, rest) = text.split_once([':', ' ', '\t']).unwrap_or((text, ""));
    let value = rest.trim().trim_start_matches([':', '=']).trim();
    let is_colon = text.starts_with(&format!("{key}:"));
    if [";", "//", "/*", "--"].iter().any(|mark| text.starts_with(mark)) {
        let comment = text.trim_start_matches([';', '/', '*', '-']).trim();
        return format!("a comment begins with `#`; write # {}", quoted(comment));
    }
    if let Some((words, value)) = text.split_once('=')
        && is_key(&words.split_whitespace().collect::<String>())
    {
        let name = words.split_whitespace().collect::<Vec<_>>().join("-");
        return format!("a key has no spaces; write {name} = {}", quoted(value));
    }
    match (is_key(key), value.is_empty()) {
        (true, true) if is_colon => {
            format!("expected a table or KEY = VALUE, found `{}`; a table begins with [{key}]", quoted(text))
        }
        (true, false) => {
            let found = if is_colon { "`:`" } else { "a value" };
            format!("expected `=` after the key, found {found}; write {key} = {}", quoted(value))
        }
        _ => format!(
            "expected [TABLE] or KEY = VALUE, found `{}`; delete it, or write `#` before a comment",
            quoted(text)
        ),
    }
}

/// A value that is no TOML.
struct Value<'v> {
    key: &'v str,
    text: &'v str,
    row: Option<&'v Row>,
    message: &'v str,
    /// The mistake is at the begin of the key.
    is_at_key: bool,
    /// Another key follows without a comma.
    lacks_comma: bool,
}

fn of_value(value: &Value<'_>) -> Option<String> {
    let rules: [fn(&Value<'_>) -> Option<String>; 13] = [
        nothing,
        second_equals,
        semicolons,
        comma,
        typographic,
        text_without_end,
        escape,
        braces,
        comment,
        second_key,
        number,
        numbers,
        missing_quotes,
    ];
    rules.iter().find_map(|rule| rule(value)).or_else(|| value.other())
}

impl Value<'_> {
    /// `expected a number from 1 to 10000 Hz, found …; write …`.
    fn expected(&self, found: &str, write: &str) -> String {
        let expected =
            self.row.map_or("a number, a text in quotes, true, false or a list", |row| &row.expected);
        format!("expected {expected}, found {found}; write {write}")
    }

    fn sort(&self) -> Option<Sort> {
        self.row.map(|row| row.sort)
    }

    /// A number with a unit or in a base of its own.
    fn in_unit(&self, found: &str) -> Option<String> {
        let row = self.row?;
        let is_integer = row.sort == Sort::Integer;
        match reading(self.text, row.unit(), is_integer) {
            Reading::Number(number) => {
                let how = if number.starts_with("0x") { "" } else { ", without a unit" };
                Some(self.expected(found, &format!("{} = {number}{how}", self.key)))
            }
            _ => {
                let foreign = row.sort.foreign(self.text, row.unit(), (self.key, &row.example))?;
                Some(format!("expected {}, found {found}; {foreign}", row.expected))
            }
        }
    }

    fn other(&self) -> Option<String> {
        let (key, row) = (self.key, self.row?);
        let write = format!("{}, such as {key} = {}", row.to_write, row.example);
        Some(self.expected(&format!("`{}`", quoted(self.text)), &write))
    }
}

fn nothing(value: &Value<'_>) -> Option<String> {
    let example = value.row.map_or("VALUE", |row| &row.example);
    value.text.is_empty().then(|| value.expected("nothing", &format!("{} = {example}", value.key)))
}

fn second_equals(value: &Value<'_>) -> Option<String> {
    let rest = value.text.strip_prefix('=')?.trim_start_matches(['=', ' ']);
    Some(format!("found `=` twice; write {} = {}", value.key, quoted(rest)))
}

/// Items of a list with semicolons between them.
fn semicolons(value: &Value<'_>) -> Option<String> {
    let items = value.text.strip_prefix('[')?.strip_suffix(']')?;
    let item = |item: &str| match value.sort() {
        Some(Sort::Texts) => format!("{:?}", item.trim().trim_matches(['"', '\''])),
        _ => item.trim().to_owned(),
    };
    let listed: Vec<_> = items.split([';', ',']).filter(|item| !item.trim().is_empty()).map(item).collect();
    items.contains(';').then(|| {
        format!(
            "expected commas between the items, found `;`; write {} = [{}]",
            value.key,
            quoted(&listed.join(", "))
        )
    })
}

/// No comma before a key or an item, or after one.
fn comma(value: &Value<'_>) -> Option<String> {
    let (key, text) = (value.key, quoted(value.text));
    match missing_comma(value.message) {
        Some(comma) if value.text.starts_with('[') && !value.is_at_key => Some(comma),
        Some(_) if value.is_at_key => {
            Some(format!("expected a comma before this key; write , {key} = {text}"))
        }
        None if !value.lacks_comma => None,
        Some(_) | None => Some(format!("expected a comma after `{text}`; write {key} = {text},")),
    }
}

fn typographic(value: &Value<'_>) -> Option<String> {
    let (key, text) = (value.key, value.text.replace(TYPOGRAPHIC, "\""));
    value.text.contains(TYPOGRAPHIC).then(|| {
        format!("found the quotes of a text processor; write {key} = {}, with straight quotes", quoted(&text))
    })
}

/// A quote at one end only.
fn text_without_end(value: &Value<'_>) -> Option<String> {
    let (key, text) = (value.key, value.text);
    let begins = text.starts_with(['"', '\'']);
    let ends = text.len() > 1 && text.ends_with(['"', '\'']);
    let quotes = text.matches(['"', '\'']).count();
    let inner = quoted(text.trim_matches(['"', '\'']));
    let end = if ends { "begin" } else { "end" };
    let is_text = begins != ends && quotes == 1 && !text.starts_with(['[', '{']);
    let differ = begins && ends && text.chars().next() != text.chars().last();
    let what =
        if differ { "different quotes at its ends".to_owned() } else { format!("no quote at its {end}") };
    (is_text || differ).then(|| format!("the text has {what}; write {key} = \"{inner}\""))
}

fn escape(value: &Value<'_>) -> Option<String> {
    let (key, text) = (value.key, value.text);
    let is_escape = text.starts_with('"') && text.contains('\\') && value.message.contains("escape");
    let inner = quoted(text.trim_matches('"'));
    is_escape.then(|| format!("`\\` begins an escape in a text; write {key} = '{inner}', with single quotes"))
}

/// A table without its first brace.
fn braces(value: &Value<'_>) -> Option<String> {
    let (name, _) = value.text.split_once('=')?;
    let inner = value.text.trim_end_matches('}').trim_end();
    is_key(name.trim()).then(|| {
        format!("expected `{{` before the keys of a table; write {} = {{ {} }}", value.key, quoted(inner))
    })
}

fn comment(value: &Value<'_>) -> Option<String> {
    if value.text.starts_with(['"', '\'', '[', '{']) {
        return None;
    }
    let (before, comment) = value.text.split_once(';').or_else(|| value.text.split_once("//"))?;
    let (before, comment) = (before.trim(), quoted(comment));
    if comment.is_empty() {
        return Some(format!(
            "a value has no semicolon; write {} = {before}, without the semicolon",
            value.key
        ));
    }
    Some(format!("a comment begins with `#`; write {} = {before} # {comment}", value.key))
}

fn second_key(value: &Value<'_>) -> Option<String> {
    if value.text.starts_with(['[', '{']) {
        return None;
    }
    let (first, _) = value.text.split_once('=')?;
    let (first, second) = first.trim_end().rsplit_once([' ', ',', '\t'])?;
    let first = first.trim().trim_end_matches(',');
    is_key(second).then(|| {
        format!("found two keys in one line; write {} = {first} and {second} = … in a line each", value.key)
    })
}

/// Something that begins like a number.
fn number(value: &Value<'_>) -> Option<String> {
    let text = value.text;
    if !text.starts_with(|letter: char| letter.is_ascii_digit() || "+-.".contains(letter)) {
        return None;
    }
    let end =
        text.find(|letter: char| !(letter.is_ascii_digit() || "+-.,".contains(letter))).unwrap_or(text.len());
    let (digits, unit) = (text[..end].trim_end_matches(','), text[end..].trim());
    let meant = digits.replace(',', ".").parse::<f64>().ok().filter(|number| number.is_finite());
    let found = format!("`{}`", quoted(text));
    let (sign, size) = digits.strip_prefix('-').map_or(("", digits), |size| ("-", size));
    let key = value.key;
    match (meant, size.split_once(',')) {
        _ if size == "0" && unit.starts_with(['x', 'X']) => value
            .in_unit(&found)
            .filter(|hint| hint.contains("write") && hint.contains(" = 0x"))
            .or_else(|| {
                Some(value.expected(
                    &found,
                    &format!("only the digits 0 to 9 and a to f after 0x, such as {key} = 0x1f"),
                ))
            }),
        (Some(_), Some((whole, part))) if part.len() == 3 && unit.is_empty() => {
            let write = format!("{key} = {sign}{whole}{part}, or {sign}{whole}.{part} with a decimal point");
            Some(value.expected(&found, &write))
        }
        (Some(meant), Some(_)) => {
            Some(value.expected(&found, &format!("{key} = {meant:?}, with a point and no comma")))
        }
        (Some(meant), None) if unit.is_empty() && (size.ends_with('.') || size.starts_with('.')) => Some(
            value.expected(&found, &format!("{key} = {meant:?}, with a digit on each side of the point")),
        ),
        (Some(meant), None) if unit.is_empty() && size.starts_with('0') => {
            Some(value.expected(&found, &format!("{key} = {meant}, without the zero before it")))
        }
        (Some(_), None)
            if unit.starts_with(|letter: char| letter.is_alphabetic() || "%°µ".contains(letter)) =>
        {
            value.in_unit(&found)
        }
        _ => None,
    }
}

/// A list of numbers with units, or of parts of π.
fn numbers(value: &Value<'_>) -> Option<String> {
    let row = value.row.filter(|row| matches!(row.sort, Sort::TwoNumbers | Sort::ThreeNumbers))?;
    let items = value.text.strip_prefix('[')?.strip_suffix(']')?;
    let number = |item| match reading(item, row.unit(), false) {
        Reading::Number(number) => Some(number),
        _ => None,
    };
    let numbers: Vec<_> = items.split(',').map(number).collect::<Option<_>>()?;
    let write = format!("{} = [{}], without units", value.key, numbers.join(", "));
    Some(value.expected(&format!("`{}`", quoted(value.text)), &write))
}

/// A word without quotes, where a text or a truth value is expected.
fn missing_quotes(value: &Value<'_>) -> Option<String> {
    let (key, text) = (value.key, value.text);
    let found = format!("`{}`", quoted(text));
    let text = text.trim_matches('`');
    match value.sort()? {
        Sort::Flag => Some(value.expected(&found, &format!("{key} = {}", flag(text)?))),
        Sort::Text if !text.contains(['"', '\'', '[', '{']) => {
            Some(value.expected(&format!("{found} without quotes"), &format!("{key} = \"{}\"", quoted(text))))
        }
        Sort::Texts if text.starts_with('[') && text.ends_with(']') && !text.contains(['"', '\'']) => {
            let texts: Vec<_> =
                text.trim_matches(['[', ']']).split(',').map(|text| format!("{:?}", text.trim())).collect();
            Some(
                value
                    .expected(&format!("{found} without quotes"), &format!("{key} = [{}]", texts.join(", "))),
            )
        }
        _ => None,
    }
}
