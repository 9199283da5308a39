//! JSON, one object per line.

use motord_untrusted::is_harmless;
use serde::Serialize;
use std::io::{self, Write};

/// Writes `value` as one line, its keys in the order of its fields.
///
/// # Errors
///
/// When `out` cannot be written.
pub fn write_line(out: &mut dyn Write, value: &impl Serialize) -> io::Result<()> {
    writeln!(out, "{}", escaped(serde_json::to_string(value)?))
}

/// Escapes the characters that a terminal obeys or hides: JSON permits them in its texts, and has
/// none elsewhere.
fn escaped(json: String) -> String {
    if json.chars().all(is_harmless) {
        return json;
    }
    let mut escaped = String::with_capacity(2 * json.len());
    for letter in json.chars() {
        if is_harmless(letter) {
            escaped.push(letter);
        } else {
            letter.encode_utf16(&mut [0; 2]).iter().for_each(|unit| escaped += &format!("\\u{unit:04x}"));
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_shows_what_terminal_would_obey() {
        let hostile = "knee\u{202e}\u{7f}\u{9b}2J\u{e0041}\u{200b} N·m";
        let mut out = Vec::new();
        write_line(&mut out, &hostile).unwrap();
        let line = String::from_utf8(out).unwrap();
        assert_eq!(line, "\"knee\\u202e\\u007f\\u009b2J\\udb40\\udc41\\u200b N·m\"\n");
        assert_eq!(serde_json::from_str::<String>(&line).unwrap(), hostile);
    }
}
