//! Bytes in hexadecimal.

use crate::rejected::Rejected;

/// Formats `bytes` as upper-case digits without separators.
pub(super) fn digits(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect()
}

/// Parses two digits per byte. Ignores spaces, dots, colons, underscores and a leading 0x.
pub(super) fn bytes(digits: &str) -> Result<Vec<u8>, Rejected> {
    let is_separator = |letter: &char| letter.is_whitespace() || ".:_".contains(*letter);
    let plain: String = digits.chars().filter(|letter| !is_separator(letter)).collect();
    let plain = plain.strip_prefix("0x").unwrap_or(&plain).as_bytes();
    let nibble = |digit: u8| (digit as char).to_digit(16);
    let byte = |pair: &[u8]| match *pair {
        [high, low] => Some((nibble(high)? << 4 | nibble(low)?) as u8),
        _ => None,
    };
    plain.chunks(2).map(|pair| byte(pair).ok_or_else(|| Rejected::Hex { received: digits.into() })).collect()
}

/// Parses the bytes of a frame: the text after `#`, or all of it.
pub(super) fn bytes_of_frame(text: &str) -> Result<Vec<u8>, Rejected> {
    bytes(text.split_once('#').map_or(text, |(_, data)| data))
}
