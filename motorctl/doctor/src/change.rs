//! The changes that mend a finding until the next start of the computer: printed as a command, made by `--tune`.

use std::fmt::{self, Display};
use std::io;
use std::process::{Command, Stdio};

/// A change of a setting of the kernel. It lasts until the next start of the computer at the longest.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Change {
    /// A text is written into a file.
    Write {
        /// The file, relative to the root of the tree.
        path: String,
        /// The text.
        text: String,
    },
    /// A program runs with these arguments.
    Run(Vec<String>),
}

impl Change {
    /// `text` into the file `path`, which is relative to the root of the tree.
    pub(crate) fn write(path: impl Into<String>, text: impl Into<String>) -> Self {
        Self::Write { path: path.into(), text: text.into() }
    }

    /// The words of a command. No shell reads them.
    pub(crate) fn run(words: &str) -> Self {
        Self::Run(words.split_whitespace().map(str::to_owned).collect())
    }

    /// Makes the change on this computer, as the user of this process. Blocks until it is made.
    ///
    /// # Errors
    ///
    /// The reason why it was not made: that of the file, or the last line of the program.
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
    let said = String::from_utf8_lossy(&output.stderr);
    let last = said.trim_end().lines().last().filter(|line| !line.is_empty());
    Err(io::Error::other(last.map_or_else(|| output.status.to_string(), str::to_owned)))
}

/// As a person types it.
impl Display for Change {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Write { path, text } => write!(out, "echo {text} | sudo tee /{path}"),
            Self::Run(words) => write!(out, "sudo {}", words.join(" ")),
        }
    }
}

/// The changes as one line of a shell: each is made, whatever became of the one before, so that an interface that was set
/// down comes up again.
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
