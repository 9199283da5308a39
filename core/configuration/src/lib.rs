//! Converts the text of a configuration file to checked [`Settings`].
//!
//! [`load`] opens a file, `table` reads it key by key, and `validate` checks it as a whole. One run
//! reports every problem ([`Problem`]). Only a file that cannot be read or parsed has a single
//! problem. No device or bus is opened.
//!
//! [`vendors`] reads the user's motors beside a configuration before.
//!
//! `keys` is the table of all keys. [`reference()`] writes `docs/configuration.md` from it.

mod describe;
mod document;
mod entry;
mod file;
mod findings;
mod keys;
pub mod lock;
mod machine;
mod origin;
mod other_unit;
mod problem;
mod reference;
mod similar;
mod sort;
mod syntax;
mod table;
mod units;
mod validate;
mod value;
pub mod vendors;

use std::fmt;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

pub use describe::describe;
pub use file::text;
pub use machine::Machine;
pub use origin::{Limit, Origin};
pub use problem::{Location, Problem, Wrong};
pub use reference::reference;
pub use similar::suggestion;

use document::Document;
use file::{fnv1a, read};
use findings::Findings;
use motord_settings::settings::Settings;
use syntax::Mistake;
use toml::de::DeTable;

/// A configuration without errors.
#[derive(Debug)]
pub struct Loaded {
    /// Its settings.
    pub settings: Settings,
    /// `[telemetry]`, which the core does not use.
    pub telemetry: TelemetrySettings,
    /// The effective limits of each motor and where they come from, in the order of
    /// `settings.motors`.
    pub limits: Vec<Vec<Limit>>,
    /// The line of the file that each `[[motor]]` begins in, from 1, in the order of
    /// `settings.motors`.
    pub motor_lines: Vec<usize>,
    /// Problems that do not prevent a run.
    pub warnings: Vec<Problem>,
    /// FNV-1a of the file's bytes, to detect later changes of the file.
    pub hash: u64,
}

/// The outputs of a daemon's metrics.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TelemetrySettings {
    /// Absolute path of a file for the textfile collector of Prometheus' node exporter.
    pub prometheus_file: Option<PathBuf>,
    /// Loopback address where Prometheus fetches them by HTTP.
    pub prometheus_listen: Option<SocketAddr>,
    /// Host names that are served at that address, besides those of the loopback interface.
    pub prometheus_hosts: Vec<String>,
}

/// Why a configuration is refused: every error found, in the order of the file's lines. At least
/// one.
#[derive(Debug)]
pub struct ConfigError {
    /// The problems, each with its place in the file.
    pub problems: Vec<Problem>,
    /// The settings, if every bus, motor and group could be built. A rejected value has its default
    /// here. For reports on the load of the buses only: they must not be run.
    pub refused: Option<Box<Settings>>,
}

impl ConfigError {
    /// Creates an error of a single problem.
    fn of(problem: Problem) -> Self {
        Self { problems: vec![problem], refused: None }
    }
}

impl fmt::Display for ConfigError {
    /// One line per problem.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, problem) in self.problems.iter().enumerate() {
            let separator = if index == 0 { "" } else { "\n" };
            write!(f, "{separator}{problem}")?;
        }
        Ok(())
    }
}

impl std::error::Error for ConfigError {}

/// Reads and checks the file at `path`, against the limits of this machine. The files of the folder
/// `models.d` beside it describe further motors.
///
/// Follows a symbolic link, so that a robot can select one of several files. Its target must be a
/// regular file that not every user may write.
///
/// # Errors
///
/// Every problem found, with file, line and key.
pub fn load(path: &Path) -> Result<Loaded, ConfigError> {
    let bytes =
        read(path).map_err(|wrong| ConfigError::of(Problem { file: path.into(), location: None, wrong }))?;
    vendors::register_beside(path).map_err(|problems| ConfigError { problems, refused: None })?;
    parse(path, &bytes, &Machine::here())
}

/// Returns whether the file at `path` has another hash than `hash`. True for a file that cannot be
/// read.
#[must_use]
pub fn has_changed(path: &Path, hash: u64) -> bool {
    read(path).map_or(true, |bytes| fnv1a(&bytes) != hash)
}

/// Checks `bytes`, the content of `file`, against the limits of `machine`. Opens no file.
///
/// # Errors
///
/// Every problem found, with file, line and key.
pub fn parse(file: &Path, bytes: &[u8], machine: &Machine) -> Result<Loaded, ConfigError> {
    let refuse = |offset, key, wrong| {
        let location = Location::at(bytes, offset, key);
        ConfigError::of(Problem { file: file.into(), location: Some(location), wrong })
    };
    if is_utf16(bytes) {
        return Err(refuse(0, None, Wrong::Utf16));
    }
    let text = std::str::from_utf8(bytes)
        .map_err(|error| refuse(error.valid_up_to(), None, Wrong::no_utf8(bytes)))?;
    let (root, errors) = DeTable::parse_recoverable(text);
    if let Some(Mistake { offset, key, wrong }) = syntax::explain(text, &errors) {
        return Err(refuse(offset, key, wrong));
    }
    if root.get_ref().is_empty() {
        return Err(ConfigError::of(Problem { file: file.into(), location: None, wrong: Wrong::Empty }));
    }
    if let Some(wrong) = document::foreign(root.get_ref()) {
        return Err(ConfigError::of(Problem { file: file.into(), location: None, wrong }));
    }
    let mut findings = Findings::new(file, text, machine);
    let document = Document::read(root.get_ref(), &mut findings);
    let settings = validate::settings(&document, &mut findings);
    let (errors, warnings) = findings.into_problems();
    match settings {
        Some(settings) if errors.is_empty() => {
            let limits = validate::limits::explained(&document, &settings, text);
            let telemetry = TelemetrySettings {
                prometheus_file: document.telemetry.prometheus_file.value,
                prometheus_listen: document.telemetry.prometheus_listen.value,
                prometheus_hosts: document.telemetry.prometheus_hosts.value.unwrap_or_default(),
            };
            let line = |offset| problem::line(bytes, offset);
            let motor_lines = document.motors.iter().map(|motor| line(motor.at.offset)).collect();
            Ok(Loaded { settings, telemetry, limits, motor_lines, warnings, hash: fnv1a(bytes) })
        }
        refused => Err(ConfigError { problems: errors, refused: refused.map(Box::new) }),
    }
}

/// A byte order mark of UTF-16, or ASCII in it without one.
fn is_utf16(bytes: &[u8]) -> bool {
    matches!(bytes, [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..] | [_, 0, _, 0, ..] | [0, _, 0, _, ..])
}
