//! The outcome of a check.

use crate::change::{self, Change};
use serde::Serialize;

/// The level of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// No action needed.
    Good,
    /// The cycle runs, but later than possible or at risk.
    Warn,
    /// The cycle is not real-time, or a bus does not work.
    Bad,
}

impl Level {
    /// Returns the word of the level.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Warn => "warn",
            Self::Bad => "bad",
        }
    }
}

/// The outcome of a check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// The check.
    pub check: &'static str,
    /// The interface or device that was checked; `None` for the computer.
    pub of: Option<String>,
    /// The level.
    pub level: Level,
    /// The measured value.
    pub measured: String,
    /// The reason why it is not good, and the remedy where there is no command.
    pub why: Option<String>,
    /// The command that fixes it.
    pub command: Option<String>,
    /// The command as changes for `--tune`. Empty where the command lasts beyond the next boot, or
    /// where a person must decide.
    #[serde(skip)]
    pub changes: Vec<Change>,
}

impl Finding {
    fn new(check: &'static str, level: Level, measured: impl Into<String>) -> Self {
        Self {
            check,
            of: None,
            level,
            measured: measured.into(),
            why: None,
            command: None,
            changes: Vec::new(),
        }
    }

    /// Creates a good finding.
    pub fn good(check: &'static str, measured: impl Into<String>) -> Self {
        Self::new(check, Level::Good, measured)
    }

    /// Creates a warning: the cycle is later than possible.
    pub fn warn(check: &'static str, measured: impl Into<String>, why: impl Into<String>) -> Self {
        Self { why: Some(why.into()), ..Self::new(check, Level::Warn, measured) }
    }

    /// Creates a bad finding: the cycle is not real-time, or a bus does not work.
    pub(crate) fn bad(check: &'static str, measured: impl Into<String>, why: impl Into<String>) -> Self {
        Self { why: Some(why.into()), ..Self::new(check, Level::Bad, measured) }
    }

    /// Sets the interface or device that was checked.
    pub fn of(self, subject: &str) -> Self {
        Self { of: Some(subject.to_owned()), ..self }
    }

    /// Sets the changes that fix it until the next boot.
    pub(crate) fn tuned_by(self, changes: Vec<Change>) -> Self {
        Self { command: Some(change::line(&changes)), changes, ..self }
    }

    /// Sets the command that fixes it.
    pub fn mended_by(self, command: impl Into<Option<String>>) -> Self {
        Self { command: command.into(), ..self }
    }
}
