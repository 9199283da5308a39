//! `motord init`: writes a first configuration, from options or from answers to questions. Opens no
//! bus.

mod draft;
mod options;
mod questions;

pub use draft::{Connection, Draft};
pub use options::Options;

use motord_configuration::{self as config, ConfigError, Machine};
use motord_settings::settings::Settings;
use motord_terminal::exit_status;
use std::fs::OpenOptions;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The rates that are tried where none is asked for, Hz: the first that the buses have time for is
/// taken.
const RATES_HZ: [f64; 8] = [1000.0, 500.0, 400.0, 250.0, 200.0, 100.0, 50.0, 20.0];

/// The values of `every` that are tried for serial buses, in this order.
const TURNS: [u32; 9] = [1, 2, 4, 5, 8, 10, 20, 25, 50];

/// Why no configuration is written.
#[derive(Debug, thiserror::Error)]
pub enum InitError {
    /// An answer cannot be used.
    #[error("{0}")]
    Answer(String),
    /// The configuration of these answers is refused.
    #[error("these answers make no configuration that motord can run:\n{0}")]
    Refused(ConfigError),
    /// There is a file already.
    #[error("{} exists: choose another --file, or replace it with --force", .0.display())]
    Exists(PathBuf),
    /// It cannot be written.
    #[error("{}: {source}", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The questions cannot be asked, or were broken off.
    #[error("no answer: {0}; give the answers as options, or take the defaults with --yes")]
    Unanswered(io::Error),
}

impl InitError {
    /// The exit status, by `sysexits.h`.
    #[must_use]
    pub const fn exit_status(&self) -> u8 {
        match self {
            Self::Answer(_) | Self::Unanswered(_) => exit_status::USAGE,
            Self::Refused(_) => exit_status::CONFIG,
            Self::Exists(_) | Self::Write { .. } => exit_status::CANNOT_CREATE,
        }
    }
}

/// A configuration that [`config::parse`] accepts.
#[derive(Debug)]
pub struct Configuration {
    /// The text of the file.
    pub text: String,
    /// Its settings.
    pub settings: Settings,
}

impl Configuration {
    /// The configuration of a robot, at the highest rate of `RATES_HZ` that its buses have time
    /// for, or at `rate_hz`.
    ///
    /// # Errors
    ///
    /// When an answer cannot be used, or when no rate fits.
    pub fn of(draft: &Draft, rate_hz: Option<f64>) -> Result<Self, InitError> {
        let mut refused = None;
        let rates = rate_hz.map_or_else(|| RATES_HZ.to_vec(), |asked| vec![asked]);
        let turns = if draft.has_serial_bus() { &TURNS[..] } else { &TURNS[..1] };
        for (rate_hz, every) in rates.iter().flat_map(|&rate| turns.iter().map(move |&every| (rate, every))) {
            let text = draft.text(rate_hz, every)?;
            match config::parse(Path::new("motord.toml"), text.as_bytes(), &Machine::here()) {
                Ok(loaded) => return Ok(Self { text, settings: loaded.settings }),
                Err(error) => refused = Some(error),
            }
        }
        Err(refused.map_or_else(|| InitError::Answer("no rate was tried".into()), InitError::Refused))
    }

    /// Writes the text to `file`. An existing file is replaced only with `force`.
    ///
    /// # Errors
    ///
    /// When there is a file, or it cannot be written.
    pub fn write(&self, file: &Path, force: bool) -> Result<(), InitError> {
        let mut options = OpenOptions::new();
        options.write(true).create_new(!force).create(true).truncate(force);
        let written = options.open(file).and_then(|mut file| file.write_all(self.text.as_bytes()));
        written.map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => InitError::Exists(file.into()),
            _ => InitError::Write { file: file.into(), source },
        })
    }

    /// Robot and next step in a few lines.
    #[must_use]
    pub fn summary(&self, file: &Path) -> String {
        let Settings { motors, buses, cycle, .. } = &self.settings;
        let is_simulated = buses.iter().all(|bus| bus.kind.is_simulated());
        let (motors, buses, rate_hz, file) = (motors.len(), buses.len(), cycle.rate_hz, file.display());
        let setup = if is_simulated {
            String::new()
        } else {
            format!(
                "\n  motorctl setup --config {file}  # new motors first, with --guide: docs/first-motor.md"
            )
        };
        format!(
            "{file}: motors: {motors}, buses: {buses}, rate: {rate_hz} Hz, cautious limits. Next:\n  motord check {file}{setup}\n  motord run {file}"
        )
    }
}
