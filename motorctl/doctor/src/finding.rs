//! The outcome of a check.

use crate::change::{self, Change};
use serde::Serialize;

/// How good a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// As it should be.
    Good,
    /// The cycle runs, but later than it could, or something threatens it.
    Warn,
    /// The cycle is not real-time, or a bus does not work.
    Bad,
}

impl Level {
    /// The word for it.
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
    /// How good it is.
    pub level: Level,
    /// The measured value.
    pub measured: String,
    /// The reason why it is not good, and the remedy where no command mends it.
    pub why: Option<String>,
    /// The command that mends it.
    pub command: Option<String>,
    /// The same as changes that `--tune` makes. None where the command lasts beyond the next start of the computer, or where a
    /// person must look first.
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

    /// A value as it should be.
    pub(crate) fn good(check: &'static str, measured: impl Into<String>) -> Self {
        Self::new(check, Level::Good, measured)
    }

    /// A value that makes the cycle later than it could be.
    pub(crate) fn warn(check: &'static str, measured: impl Into<String>, why: impl Into<String>) -> Self {
        Self { why: Some(why.into()), ..Self::new(check, Level::Warn, measured) }
    }

    /// A value with which the cycle is not real-time, or a bus does not work.
    pub(crate) fn bad(check: &'static str, measured: impl Into<String>, why: impl Into<String>) -> Self {
        Self { why: Some(why.into()), ..Self::new(check, Level::Bad, measured) }
    }

    /// With the interface or device that was checked.
    pub(crate) fn of(self, subject: &str) -> Self {
        Self { of: Some(subject.to_owned()), ..self }
    }

    /// With the changes that mend it until the next start of the computer.
    pub(crate) fn tuned_by(self, changes: Vec<Change>) -> Self {
        Self { command: Some(change::line(&changes)), changes, ..self }
    }

    /// With the command that mends it.
    pub(crate) fn mended_by(self, command: impl Into<Option<String>>) -> Self {
        Self { command: command.into(), ..self }
    }
}
