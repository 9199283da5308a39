//! The source of an emergency stop, as the process that requests it names it: a button, a person, a
//! page. The log and the history of a group show it behind the process. Nothing else depends on it.

/// The request for an emergency stop.
pub const REQUEST: &[u8] = b"motord emergency stop 1";
/// Limit on the bytes of a source.
pub const SOURCE_BYTES_MAX: usize = 128;
/// Between the request and the source.
const SEPARATOR: u8 = b'\n';

/// A source: at most [`SOURCE_BYTES_MAX`] bytes of text. Copies without an allocation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StopSource {
    bytes: [u8; SOURCE_BYTES_MAX],
    length: usize,
}

impl StopSource {
    /// No source.
    pub const NONE: Self = Self { bytes: [0; SOURCE_BYTES_MAX], length: 0 };

    /// Takes the first bytes of `text`, without control characters.
    #[must_use]
    pub fn new(text: &str) -> Self {
        let mut source = Self::NONE;
        for letter in text.chars().filter(|letter| !letter.is_control()) {
            let end = source.length + letter.len_utf8();
            let Some(free) = source.bytes.get_mut(source.length..end) else { break };
            letter.encode_utf8(free);
            source.length = end;
        }
        source
    }

    /// Returns the source of a message that requests a stop; `None` for any other message. Does not
    /// allocate.
    #[must_use]
    pub fn of_request(message: &[u8]) -> Option<Self> {
        match message.strip_prefix(REQUEST)?.split_first() {
            None => Some(Self::NONE),
            // A text that is damaged stops the robot too.
            Some((&SEPARATOR, text)) => Some(std::str::from_utf8(text).map_or(Self::NONE, Self::new)),
            Some(_) => None,
        }
    }

    /// Returns the text; `None` without one.
    #[must_use]
    pub fn text(&self) -> Option<&str> {
        let text = std::str::from_utf8(self.bytes.get(..self.length)?).ok()?;
        Some(text).filter(|text| !text.is_empty())
    }

    /// Writes the message that requests a stop for this source to `message`, and returns its bytes.
    /// Async-signal-safe.
    pub(crate) fn request<'m>(&self, message: &'m mut [u8; REQUEST_BYTES_MAX]) -> &'m [u8] {
        if self.length == 0 {
            return REQUEST;
        }
        let text = REQUEST.len() + 1;
        message[..REQUEST.len()].copy_from_slice(REQUEST);
        message[REQUEST.len()] = SEPARATOR;
        message[text..text + self.length].copy_from_slice(&self.bytes[..self.length]);
        &message[..text + self.length]
    }
}

/// Limit on the bytes of a request.
pub(crate) const REQUEST_BYTES_MAX: usize = REQUEST.len() + 1 + SOURCE_BYTES_MAX;

#[cfg(test)]
mod tests {
    use super::*;

    fn returned(text: &str) -> Option<StopSource> {
        StopSource::of_request(StopSource::new(text).request(&mut [0; REQUEST_BYTES_MAX]))
    }

    #[test]
    fn request_carries_its_source() {
        for text in ["", "the gamepad, button B", "ärm ✋", &"✋".repeat(100)] {
            assert_eq!(returned(text), Some(StopSource::new(text)));
        }
        assert_eq!(returned("the page by anna").unwrap().text(), Some("the page by anna"));
        assert_eq!(returned("").unwrap().text(), None);
    }

    #[test]
    fn long_source_is_cut_between_characters() {
        let source = StopSource::new(&"✋".repeat(100));
        assert_eq!(source.text().unwrap().chars().count(), SOURCE_BYTES_MAX / 3);
    }

    #[test]
    fn damaged_source_stops_without_a_text() {
        let with = |text: &[u8]| StopSource::of_request(&[REQUEST, b"\n", text].concat());
        assert_eq!(with(b"\xff\xfe"), Some(StopSource::NONE));
        assert_eq!(with(b"a\nb\x1b[2Jc").unwrap().text(), Some("ab[2Jc"));
        assert_eq!(StopSource::of_request(REQUEST), Some(StopSource::NONE));
    }

    #[test]
    fn other_message_is_no_request() {
        for message in [b"".as_slice(), b"motord emergency stop", b"motord emergency stop 12", b"x"] {
            assert_eq!(StopSource::of_request(message), None);
        }
    }
}
