//! The name of a network interface.

use core::fmt;
use core::str::FromStr;

/// A name that is safe everywhere: 1 to 15 ASCII letters, digits, `-`, `_` or `.`, neither `.` nor
/// `..`. It can be used in a path, a log line and a shell command without escaping.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct InterfaceName {
    bytes: [u8; Self::MAX],
    len: u8,
}

/// The error for a text that is not a name of an interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("an interface name has 1 to 15 letters, digits, '-', '_' or '.'")]
pub struct InvalidName;

impl InterfaceName {
    /// Longest name in bytes (`IFNAMSIZ` without its terminating zero).
    pub const MAX: usize = 15;

    /// Returns the name as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        str::from_utf8(&self.bytes[..usize::from(self.len)]).expect("a name is checked to be ASCII")
    }
}

impl FromStr for InterfaceName {
    type Err = InvalidName;

    fn from_str(text: &str) -> Result<Self, InvalidName> {
        let allowed = |byte: &u8| byte.is_ascii_alphanumeric() || b"-_.".contains(byte);
        let valid =
            !text.is_empty() && text.bytes().all(|byte| allowed(&byte)) && text != "." && text != "..";
        let mut bytes = [0; Self::MAX];
        let name = bytes.get_mut(..text.len()).filter(|_| valid).ok_or(InvalidName)?;
        name.copy_from_slice(text.as_bytes());
        Ok(Self { bytes, len: text.len() as u8 })
    }
}

impl fmt::Display for InterfaceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl fmt::Debug for InterfaceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn name_is_safe_in_path_and_command() {
        for name in ["can0", "vcan12", "front-left_3.1", "a23456789012345"] {
            assert_eq!(name.parse::<InterfaceName>().unwrap().as_str(), name);
        }
        for name in [
            "",
            ".",
            "..",
            "a/b",
            "../can0",
            "can 0",
            "can0;",
            "can0\n",
            "cän0",
            "a234567890123456",
            "can0\0",
        ] {
            assert_eq!(name.parse::<InterfaceName>(), Err(InvalidName), "{name:?}");
        }
    }
}
