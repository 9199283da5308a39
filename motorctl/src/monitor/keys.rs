//! The keys in the bytes of a terminal.
//!
//! A SPACE is a key at once, wherever it stands, except in pasted text. The end mark of a paste can
//! be lost: a silence ends the paste also, so the key of the emergency stop soon works again.

use super::view::STOP_KEY;
use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

/// The bytes of one key, or of one chunk of pasted text, follow each other faster, ms.
pub(super) const SILENCE: u8 = 200;

const ESC: u8 = 0x1b;
const PASTE_BEGIN: &[u8] = b"200~";
const PASTE_END: &[u8] = b"\x1b[201~";
/// More bytes than any key of the monitor has.
const SEQUENCE_MAX: usize = 16;

/// An input of the user.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Input {
    /// Presses a key.
    Key(KeyEvent),
    /// Pastes text, which is ignored.
    Pasted,
}

/// Reads the bytes one by one. Names of joints and buses are ASCII, so other letters are ignored.
#[derive(Debug, Default)]
pub(super) struct Keys {
    reading: Reading,
    /// The bytes of the sequence, or the part of the end mark that has arrived.
    bytes: Vec<u8>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum Reading {
    #[default]
    Letters,
    /// After ESC, which may be a key or the first byte of one.
    Escape,
    /// After `ESC [`.
    Sequence,
    /// After `ESC O`, until the one letter.
    Application,
    /// Within pasted text.
    Paste,
}

impl Keys {
    /// Reads one byte, and passes what it completes to `done`. Never blocks.
    pub(super) fn read(&mut self, byte: u8, mut done: impl FnMut(Input)) {
        let is_stop = self.reading != Reading::Paste && KeyCode::Char(byte.into()) == STOP_KEY;
        match self.reading {
            _ if is_stop => {
                self.silent(&mut done);
                press(STOP_KEY, done);
            }
            Reading::Paste => self.skip(byte),
            Reading::Letters if byte == ESC => self.begin(Reading::Escape),
            Reading::Letters => letter(byte, done),
            Reading::Escape => self.escaped(byte, done),
            Reading::Sequence => self.sequence(byte, done),
            Reading::Application => {
                self.begin(Reading::Letters);
                named(byte, done);
            }
        }
    }

    /// Ends what [`SILENCE`] without a byte ends: a key of ESC alone, a part of a key, pasted text.
    pub(super) fn silent(&mut self, done: impl FnOnce(Input)) {
        if self.reading == Reading::Escape {
            press(KeyCode::Esc, done);
        }
        self.begin(Reading::Letters);
    }

    fn begin(&mut self, reading: Reading) {
        self.reading = reading;
        self.bytes.clear();
    }

    fn skip(&mut self, byte: u8) {
        if PASTE_END.get(self.bytes.len()) != Some(&byte) {
            self.bytes.clear();
        }
        if PASTE_END.get(self.bytes.len()) == Some(&byte) {
            self.bytes.push(byte);
        }
        if self.bytes == PASTE_END {
            self.begin(Reading::Letters);
        }
    }

    fn escaped(&mut self, byte: u8, mut done: impl FnMut(Input)) {
        match byte {
            b'[' => self.begin(Reading::Sequence),
            b'O' => self.begin(Reading::Application),
            ESC => press(KeyCode::Esc, done),
            // The letter with Alt, which is no key of the monitor.
            b'!'..=b'~' => self.begin(Reading::Letters),
            _ => {
                self.silent(&mut done);
                letter(byte, done);
            }
        }
    }

    fn sequence(&mut self, byte: u8, mut done: impl FnMut(Input)) {
        if byte == ESC {
            return self.begin(Reading::Escape);
        }
        self.bytes.push(byte);
        // `ESC [ [` and a letter are function keys of the Linux console.
        let is_open = matches!(byte, 0x20..0x40) || self.bytes == b"[";
        if is_open && self.bytes.len() < SEQUENCE_MAX {
            return;
        }
        let bytes = std::mem::take(&mut self.bytes);
        self.begin(Reading::Letters);
        match bytes[..] {
            _ if bytes == PASTE_BEGIN => {
                self.begin(Reading::Paste);
                done(Input::Pasted);
            }
            [one] => named(one, done),
            [number, b'~'] => numbered(number, done),
            _ => {}
        }
    }
}

fn press(code: KeyCode, done: impl FnOnce(Input)) {
    done(Input::Key(code.into()));
}

fn letter(byte: u8, done: impl FnOnce(Input)) {
    match byte {
        b'\r' | b'\n' => press(KeyCode::Enter, done),
        b'\t' => press(KeyCode::Tab, done),
        0x08 | 0x7f => press(KeyCode::Backspace, done),
        1..=26 => {
            let letter = KeyCode::Char((byte - 1 + b'a').into());
            done(Input::Key(KeyEvent::new(letter, KeyModifiers::CONTROL)));
        }
        b' '..=b'~' => press(KeyCode::Char(byte.into()), done),
        _ => {}
    }
}

/// The keys that end with a letter.
fn named(byte: u8, done: impl FnOnce(Input)) {
    let code = match byte {
        b'A' => KeyCode::Up,
        b'B' => KeyCode::Down,
        b'C' => KeyCode::Right,
        b'D' => KeyCode::Left,
        b'H' => KeyCode::Home,
        b'F' => KeyCode::End,
        _ => return,
    };
    press(code, done);
}

/// The keys that end with `~`.
fn numbered(number: u8, done: impl FnOnce(Input)) {
    let code = match number {
        b'1' | b'7' => KeyCode::Home,
        b'4' | b'8' => KeyCode::End,
        b'5' => KeyCode::PageUp,
        b'6' => KeyCode::PageDown,
        _ => return,
    };
    press(code, done);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reads each piece, with a silence after it.
    fn read(pieces: &[&[u8]]) -> Vec<Input> {
        let (mut keys, mut inputs) = (Keys::default(), Vec::new());
        for piece in pieces {
            piece.iter().for_each(|byte| keys.read(*byte, |input| inputs.push(input)));
            keys.silent(|input| inputs.push(input));
            assert_eq!(keys.reading, Reading::Letters);
        }
        inputs
    }

    fn codes(inputs: &[Input]) -> Vec<KeyCode> {
        let code = |input: &Input| if let Input::Key(key) = input { Some(key.code) } else { None };
        inputs.iter().filter_map(code).collect()
    }

    #[test]
    fn stop_key_works_behind_every_part_of_key() {
        let parts: [&[u8]; 8] =
            [b"", b"\x1b", b"\x1b[", b"\x1b[1;", b"\x1b[200", b"\x1bO", b"\x1b[[", b"\xc3"];
        for part in parts {
            let bytes = [part, b" "].concat();
            assert_eq!(codes(&read(&[&bytes])).last(), Some(&STOP_KEY), "{part:?}");
        }
    }

    #[test]
    fn paste_ends_with_its_mark_or_silence() {
        let ended: &[&[u8]] = &[b"\x1b[200~run q\x1b[20\x1b[201~ "];
        assert_eq!(read(ended), [Input::Pasted, Input::Key(STOP_KEY.into())]);
        let lost: &[&[u8]] = &[b"\x1b[200~run q\x1b[201", b" "];
        assert_eq!(read(lost), [Input::Pasted, Input::Key(STOP_KEY.into())]);
        assert_eq!(read(&[b"\x1b[200~a\x1b\x1b[201~"]), [Input::Pasted]);
    }

    #[test]
    fn terminals_name_their_keys_differently() {
        use KeyCode::{Backspace, Char, Down, End, Enter, Esc, Home, Left, PageDown, PageUp, Right, Tab, Up};
        let bytes: &[u8] = b"\x1b[A\x1bOB\x1b[C\x1b[D\x1b[H\x1bOF\x1b[1~\x1b[8~\x1b[5~\x1b[6~\r\t\x7fq/\x1b";
        let keys = [Up, Down, Right, Left, Home, End, Home, End, PageUp, PageDown, Enter, Tab, Backspace];
        assert_eq!(codes(&read(&[bytes])), [&keys[..], &[Char('q'), Char('/'), Esc]].concat());
        let control = Input::Key(KeyEvent::new(Char('c'), KeyModifiers::CONTROL));
        assert_eq!(read(&[b"\x03"]), [control]);
    }

    /// Function keys, keys with Alt or Shift, reports of the terminal, letters of other scripts.
    #[test]
    fn other_keys_do_nothing() {
        let others: &[&[u8]] =
            &[b"\x1b[[C", b"\x1b[15~", b"\x1bOP", b"\x1b[1;5A", b"\x1b[3~", b"\x1b[?62;c", "ü°".as_bytes()];
        for other in others {
            assert_eq!(read(&[other]), [], "{other:?}");
        }
    }

    #[test]
    fn no_bytes_crash_or_accumulate() {
        let (mut keys, mut state) = (Keys::default(), 1_u32);
        for _ in 0..100_000 {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let byte = *b"\x1b[[O2001~A;? q\xff".get((state >> 28) as usize).unwrap_or(&b'x');
            keys.read(byte, |_| {});
            assert!(keys.bytes.len() <= SEQUENCE_MAX);
        }
    }
}
