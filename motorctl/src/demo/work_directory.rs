//! The private directory of a demo, for runtime files and logs.

use crate::demo::error::DemoError;
use motord_client::DEFAULT_INSTANCE;
use motord_terminal::InputFile;
use serde::Deserialize;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The configuration of the demo in a checkout.
const CONFIG: &str = "config/quadruped-simulated.toml";
/// The same, for an installed motorctl.
const BUILT_IN_CONFIG: &str = include_str!("../../../config/quadruped-simulated.toml");
/// Largest configuration, bytes: that of the daemon.
const CONFIG_BYTES_MAX: u64 = 1 << 20;
/// Lines of a log that are shown when its process failed.
const LOG_END_LINES: usize = 20;

/// A temporary directory, and the configuration of the demo.
#[derive(Debug)]
pub(crate) struct WorkDirectory {
    directory: TempDir,
    config: PathBuf,
    instance: String,
}

/// The part of a configuration that the demo needs. The daemon checks the rest.
#[derive(Debug, Default, Deserialize)]
struct Head {
    #[serde(default)]
    daemon: DaemonHead,
}

#[derive(Debug, Default, Deserialize)]
struct DaemonHead {
    instance: Option<String>,
}

impl WorkDirectory {
    /// Creates the directory. Uses `config`, otherwise the checkout's configuration, otherwise the
    /// built-in one.
    ///
    /// # Errors
    ///
    /// The directory cannot be created, or the configuration cannot be read.
    pub(crate) fn new(config: Option<&Path>) -> Result<Self, DemoError> {
        let directory = temporary_directory().map_err(DemoError::system("create a private directory"))?;
        let config = match config {
            Some(config) => config.to_owned(),
            None if Path::new(CONFIG).is_file() => PathBuf::from(CONFIG),
            None => {
                let copy = directory.path().join("quadruped-simulated.toml");
                fs::write(&copy, BUILT_IN_CONFIG).map_err(DemoError::system("write the configuration"))?;
                copy
            }
        };
        let text = InputFile::open(&config).and_then(|file| file.read_text(CONFIG_BYTES_MAX));
        let text = text.map_err(|error| DemoError::system("read the configuration")(error.into()))?;
        let head: Head = toml::from_str(&text).unwrap_or_default();
        let instance = head.daemon.instance.unwrap_or_else(|| DEFAULT_INSTANCE.to_owned());
        Ok(Self { directory, config, instance })
    }

    /// Returns the runtime directory.
    pub(crate) fn runtime(&self) -> &Path {
        self.directory.path()
    }

    /// The daemon's configuration.
    pub(crate) fn config(&self) -> &Path {
        &self.config
    }

    /// The instance in that configuration.
    pub(crate) fn instance(&self) -> &str {
        &self.instance
    }

    /// Creates a file for the log `name`.
    ///
    /// # Errors
    ///
    /// The file cannot be created.
    pub(crate) fn log(&self, name: &str) -> io::Result<File> {
        File::create(self.directory.path().join(name))
    }

    /// Returns the last lines of the log `name`.
    pub(crate) fn log_end(&self, name: &str) -> String {
        let log = fs::read(self.directory.path().join(name)).unwrap_or_default();
        let log = String::from_utf8_lossy(&log);
        let lines: Vec<&str> = log.lines().collect();
        lines[lines.len().saturating_sub(LOG_END_LINES)..].join("\n")
    }
}

/// Creates a directory in memory where possible: a disk would delay the shared files.
fn temporary_directory() -> io::Result<TempDir> {
    let builder = || {
        let mut builder = tempfile::Builder::new();
        builder.prefix("motord-demo-");
        builder
    };
    builder().tempdir_in("/dev/shm").or_else(|_| builder().tempdir())
}
