//! Changes that fix a finding until the next boot. They are printed as commands, and `--tune` makes
//! them.

use std::fmt::{self, Display};
use std::io;
use std::process::{Command, Stdio};

/// A change of a kernel setting. It lasts until the next boot at most.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Change {
    /// Writes a text to a file.
    Write {
        /// The file, relative to the root of the tree.
        path: String,
        /// The text.
        text: String,
    },
    /// Runs a program with arguments.
    Run(Vec<String>),
}

impl Change {
    /// Creates a write of `text` to the file `path`, relative to the root of the tree.
    pub(crate) fn write(path: impl Into<String>, text: impl Into<String>) -> Self {
        Self::Write { path: path.into(), text: text.into() }
    }

    /// Splits a command into words. No shell reads them.
    pub(crate) fn run(words: &str) -> Self {
        Self::Run(words.split_whitespace().map(str::to_owned).collect())
    }

    /// Makes the change on this computer, as the user of this process. Blocks until it is done.
    ///
    /// # Errors
    ///
    /// The error of the file, or the last line that the program printed.
    pub fn apply(&self) -> io::Result<()> {
        match self {
            Self::Write { path, text } => std::fs::write(format!("/{path}"), text),
            Self::Run(words) => run(words),
        }
    }
}

fn run(words: &[String]) -> io::Result<()> {
    let [program, arguments @ ..] = words else { return Ok(()) };
    let output = Command::new(program).args(arguments).stdin(Stdio::null()).output()?;
    if output.status.success() {
        return Ok(());
    }
    let stderr = String::from_utf8_lossy(&output.stderr);
    let last = stderr.trim_end().lines().last().filter(|line| !line.is_empty());
    Err(io::Error::other(last.map_or_else(|| output.status.to_string(), str::to_owned)))
}

/// Formats the change as a shell command.
impl Display for Change {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Write { path, text } => write!(out, "echo {text} | sudo tee /{path}"),
            Self::Run(words) => write!(out, "sudo {}", words.join(" ")),
        }
    }
}

/// Formats the changes as one shell line. Each runs even if the one before failed, so that an
/// interface that was set down comes up again.
pub(crate) fn line(changes: &[Change]) -> String {
    changes.iter().map(Change::to_string).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failing_and_missing_programs_are_explained() {
        let missing = Change::run("motord-no-such-program 1").apply().unwrap_err();
        assert_eq!(missing.kind(), io::ErrorKind::NotFound);
        let refused = Change::run("ls /motord-no-such-file").apply().unwrap_err();
        assert!(refused.to_string().contains("/motord-no-such-file"), "{refused}");
        assert!(Change::run("true").apply().is_ok());
    }

    #[test]
    fn words_of_a_configuration_reach_no_shell() {
        let change = Change::run("test can0;false = can0;false");
        assert!(change.apply().is_ok());
    }

    #[test]
    fn a_written_text_is_in_the_file() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let path = file.path().to_str().unwrap().trim_start_matches('/').to_owned();
        Change::write(path, "performance").apply().unwrap();
        assert_eq!(std::fs::read_to_string(file.path()).unwrap(), "performance");
    }
}
