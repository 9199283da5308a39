//! The lock file: what each motor reported about itself to `motorctl setup`.
//!
//! Its path is next to the configuration: `motord.lock.toml` for `motord.toml`. [`findings`]
//! compares it, or a current report of a motor, with the configuration.

mod finding;

pub use finding::{Finding, Verdict, end_findings, end_lines, findings, mismatches};

use crate::file::read;
use crate::problem::Wrong;

use motord_protocol::commissioning::ReportedMotor;
use motord_untrusted::recreate;
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The form of the file.
const FORM: u32 = 1;
const HEAD: &str = "\
# Written by `motorctl setup`: what each motor said of itself. motord does not arm a motor that says something else than its
# configuration. Do not edit: run `motorctl setup` again after a motor or the configuration was changed.
";

/// The lock file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lock {
    form: u32,
    /// The motors that answered.
    #[serde(default, rename = "motor")]
    pub motors: Vec<ReportedMotor>,
}

/// An unusable lock file.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// It cannot be read or written.
    #[error("{}: {wrong}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// Why.
        wrong: Box<Wrong>,
    },
    /// It is not in the form of a lock file.
    #[error("{}: {reason}; write it anew with `motorctl setup`", file.display())]
    Malformed {
        /// The file.
        file: PathBuf,
        /// The mistake.
        reason: String,
    },
}

impl Lock {
    /// Creates a lock of these motors.
    #[must_use]
    pub const fn new(motors: Vec<ReportedMotor>) -> Self {
        Self { form: FORM, motors }
    }

    /// Returns the path of the lock of this configuration.
    #[must_use]
    pub fn path(config: &Path) -> PathBuf {
        config.with_extension("lock.toml")
    }

    /// Reads the lock beside the configuration `config`; `None` where there is none.
    ///
    /// # Errors
    ///
    /// When there is one that cannot be read, or that is no lock.
    pub fn load(config: &Path) -> Result<Option<Self>, LockError> {
        let file = Self::path(config);
        let failed = |wrong| LockError::File { file: file.clone(), wrong: Box::new(wrong) };
        match fs::symlink_metadata(&file) {
            // A link without a target is no missing lock.
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(failed(error.into())),
            Ok(_) => {}
        }
        let bytes = read(&file).map_err(failed)?;
        let malformed = |reason: String| LockError::Malformed { file: file.clone(), reason };
        let text = str::from_utf8(&bytes).map_err(|error| malformed(error.to_string()))?;
        let lock: Self = toml::from_str(text).map_err(|error| malformed(error.message().to_owned()))?;
        match lock.form {
            FORM => Ok(Some(lock)),
            form => Err(malformed(format!("form {form} is not known, expected {FORM}"))),
        }
    }

    /// Writes the lock beside the configuration `config` atomically.
    ///
    /// # Errors
    ///
    /// When it cannot be written.
    pub fn save(&self, config: &Path) -> Result<PathBuf, LockError> {
        let file = Self::path(config);
        let text = toml::to_string(self)
            .map_err(|error| LockError::Malformed { file: file.clone(), reason: error.to_string() })?;
        let next = file.with_extension("toml.new");
        let written = replace(&next, &file, &format!("{HEAD}{text}"));
        written.map_err(|error| LockError::File { file: file.clone(), wrong: Box::new(error.into()) })?;
        Ok(file)
    }

    /// Returns the motor of this name, if it answered.
    #[must_use]
    pub fn motor(&self, name: &str) -> Option<&ReportedMotor> {
        self.motors.iter().find(|motor| motor.name == name)
    }
}

/// Replaces `file` atomically. Removes what has the temporary name `next`, and follows no link
/// there.
fn replace(next: &Path, file: &Path, text: &str) -> io::Result<()> {
    recreate(next)?.write_all(text.as_bytes())?;
    fs::rename(next, file)
}
