//! The tokens: a file with a line for each person.

use std::fs::File;
use std::io::Read;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use subtle::{Choice, ConstantTimeEq};

/// Limit on the file, bytes.
const FILE_MAX: u64 = 16 * 1024;
/// Limit on persons.
const PERSONS_MAX: usize = 32;
/// Limit on a name, bytes.
const NAME_MAX: usize = 32;
/// Lengths of a token, bytes.
const TOKEN_MIN: usize = 16;
const TOKEN_MAX: usize = 128;

/// A person and the token by which a request names this person.
struct Token {
    person: String,
    secret: Vec<u8>,
}

/// The known tokens. They are never printed.
pub(crate) struct Tokens(Vec<Token>);

impl Tokens {
    /// Reads the file. The error is a sentence that says what to do.
    pub(crate) fn read(path: &Path) -> Result<Self, String> {
        let text = read_secret(path, FILE_MAX)?;
        let text = String::from_utf8(text).map_err(|_| format!("{}: not UTF-8", path.display()))?;
        Self::parse(&text).map_err(|error| format!("{}: {error}", path.display()))
    }

    /// Parses lines `NAME TOKEN`. Empty lines and lines that begin with `#` do not count.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let mut tokens: Vec<Token> = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let number = index + 1;
            let words: Vec<&str> = line.split_whitespace().collect();
            let (person, secret) = match words.as_slice() {
                [] => continue,
                [first, ..] if first.starts_with('#') => continue,
                [person, secret] => (*person, *secret),
                _ => return Err(format!("line {number}: write a name, a space and a token")),
            };
            let is_name = |letter: u8| letter.is_ascii_alphanumeric() || b"._-".contains(&letter);
            if person.len() > NAME_MAX || !person.bytes().all(is_name) {
                return Err(format!(
                    "line {number}: a name has at most {NAME_MAX} letters, digits, dots, dashes and underscores"
                ));
            }
            if !(TOKEN_MIN..=TOKEN_MAX).contains(&secret.len())
                || !secret.bytes().all(|byte| byte.is_ascii_graphic())
            {
                return Err(format!(
                    "line {number}: a token has {TOKEN_MIN} to {TOKEN_MAX} ASCII characters; \
                     `openssl rand -hex 16` prints one"
                ));
            }
            if tokens.iter().any(|token| token.person == person || token.secret == secret.as_bytes()) {
                return Err(format!("line {number}: this name or token is in an earlier line"));
            }
            tokens.push(Token { person: person.to_owned(), secret: secret.as_bytes().to_vec() });
        }
        match tokens.len() {
            0 => Err("no token: write a line with a name, a space and a token".to_owned()),
            1..=PERSONS_MAX => Ok(Self(tokens)),
            count => Err(format!("{count} tokens; at most {PERSONS_MAX} are allowed")),
        }
    }

    /// Returns the person whose token this is. Compares with every token, in a time that depends on
    /// the lengths only.
    pub(crate) fn person(&self, secret: &[u8]) -> Option<&str> {
        let mut found = None;
        for token in &self.0 {
            let is_equal: Choice = token.secret.ct_eq(secret);
            if bool::from(is_equal) {
                found = Some(token.person.as_str());
            }
        }
        found
    }
}

/// Reads a regular file of at most `most` bytes that other users may not read.
pub(crate) fn read_secret(path: &Path, most: u64) -> Result<Vec<u8>, String> {
    let failed = |error: std::io::Error| format!("cannot read {}: {error}", path.display());
    let file = File::open(path).map_err(failed)?;
    let metadata = file.metadata().map_err(failed)?;
    if !metadata.is_file() || metadata.len() > most {
        return Err(format!("{}: not a file of at most {most} bytes", path.display()));
    }
    if metadata.permissions().mode() & 0o007 != 0 {
        let path = path.display();
        return Err(format!("every user may open {path}: run `chmod o= {path}`"));
    }
    let mut bytes = Vec::new();
    file.take(most).read_to_end(&mut bytes).map_err(failed)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        Tokens::parse(text).err().unwrap()
    }

    #[test]
    fn token_names_its_person() {
        let tokens = Tokens::parse("# who\nanna 0123456789abcdef\n\nbert fedcba9876543210\n").unwrap();
        assert_eq!(tokens.person(b"0123456789abcdef"), Some("anna"));
        assert_eq!(tokens.person(b"fedcba9876543210"), Some("bert"));
        for wrong in [&b""[..], b"0123456789abcde", b"0123456789abcdef0", b"0123456789abcdeF", b"anna"] {
            assert_eq!(tokens.person(wrong), None);
        }
    }

    #[test]
    fn weak_or_damaged_lines_are_refused() {
        assert!(error("").contains("no token"));
        assert!(error("anna short").contains("openssl"));
        assert!(error("anna").contains("line 1"));
        assert!(error("# \nanna 0123456789abcdef more").contains("line 2"));
        assert!(error("an/na 0123456789abcdef").contains("letters"));
        assert!(error("anna 0123456789abcdef\nbert 0123456789abcdef").contains("earlier"));
        let many: Vec<_> = (0..33).map(|number| format!("p{number} 0123456789abcd{number:02}")).collect();
        assert!(error(&many.join("\n")).contains("at most 32"));
    }

    #[test]
    fn file_that_everybody_may_read_is_refused() {
        let path = std::env::temp_dir().join(format!("motord-bridge-token-{}", std::process::id()));
        std::fs::write(&path, "anna 0123456789abcdef\n").unwrap();
        let with_mode = |mode| {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            Tokens::read(&path).map(|_| ())
        };
        let outcomes = (with_mode(0o640), with_mode(0o644));
        std::fs::remove_file(&path).unwrap();
        assert_eq!(outcomes.0, Ok(()));
        assert!(outcomes.1.unwrap_err().contains("chmod"));
        assert!(Tokens::read(Path::new("/dev/zero")).is_err());
    }
}
