//! Files and texts that another user or process may have made.
//!
//! - [`InputFile`]: a file to read. It is a regular file, and has a limit.
//! - [`recreate`]: a file to write, in place of what another user may have created there.
//! - [`printable`] and [`printable_line`]: text for a terminal, a log or a page.

#![forbid(unsafe_code)]

mod file;

pub use file::{InputError, InputFile, recreate};

use std::borrow::Cow;

/// Returns whether `letter` neither commands a terminal nor hides, joins or reorders other letters.
/// A line end is not harmless.
///
/// Source of the invisible characters: Unicode 16, `Bidi_Control`, `Join_Control` and the format
/// characters (`Cf`) without a glyph; the line and paragraph separators.
#[must_use]
pub fn is_harmless(letter: char) -> bool {
    let is_invisible = matches!(letter,
        '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
        | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}');
    !letter.is_control() && !is_invisible
}

/// Spells out every character that is not [harmless](is_harmless), as `\u{1b}`. Line ends stay.
/// Text of a file or another process must not move the cursor, change colours, ring, or look like
/// other text.
#[must_use]
pub fn printable(text: &str) -> Cow<'_, str> {
    spelled(text, |letter| letter == '\n' || is_harmless(letter))
}

/// The same for a text of one line: line ends are spelled out.
#[must_use]
pub fn printable_line(text: &str) -> Cow<'_, str> {
    spelled(text, is_harmless)
}

fn spelled(text: &str, stays: impl Fn(char) -> bool) -> Cow<'_, str> {
    if text.chars().all(&stays) {
        return Cow::Borrowed(text);
    }
    let mut spelled = String::with_capacity(2 * text.len());
    for letter in text.chars() {
        match (stays(letter), letter) {
            (true, letter) => spelled.push(letter),
            (false, '\n' | '\r' | '\t') => spelled.extend(letter.escape_default()),
            (false, letter) => spelled.extend(letter.escape_unicode()),
        }
    }
    Cow::Owned(spelled)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_that_a_terminal_obeys_is_left() {
        assert_eq!(printable("knee\x1b[31m\u{9b}2J\r\x07\n"), "knee\\u{1b}[31m\\u{9b}2J\\r\\u{7}\n");
        assert_eq!(printable_line("two\nlines\x7f"), "two\\nlines\\u{7f}");
        assert!(matches!(printable("Torque 2 N·m\n"), Cow::Borrowed(_)));
    }

    /// CVE-2021-42574: controls of direction make text look like another one.
    #[test]
    fn text_is_neither_reordered_nor_hidden() {
        for letter in
            ['\u{202e}', '\u{2066}', '\u{200b}', '\u{200d}', '\u{feff}', '\u{ad}', '\u{2028}', '\u{e0041}']
        {
            let expected = format!("a{}b", letter.escape_unicode());
            assert_eq!(printable(&format!("a{letter}b")), expected);
        }
        assert!(matches!(printable("é ß 足 — € 😀"), Cow::Borrowed(_)));
    }
}
