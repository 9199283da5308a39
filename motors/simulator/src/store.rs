//! The memories of motors in files, which persist across processes.

use crate::{InjectError, Motor, SimulatedBus};
use motord_untrusted::{InputError, InputFile};
use std::collections::HashMap;
use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};

/// Largest memory, bytes: a hundred times that of a motor.
const BYTES_MAX: u64 = 1 << 20;

/// A directory with a file for each motor, `NAME.memory`: its drive's non-volatile memory, a line
/// for each item of GIM document, table 7.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
    /// Revision of each motor's memory in its file.
    kept: HashMap<String, u32>,
}

impl Store {
    /// Uses `folder`, and creates it if it does not exist.
    ///
    /// # Errors
    ///
    /// The folder cannot be created.
    pub fn open(folder: &Path) -> Result<Self, Error> {
        std::fs::create_dir_all(folder)?;
        Ok(Self { folder: folder.to_owned(), kept: HashMap::new() })
    }

    /// Loads the stored memories into the motors of `bus`.
    ///
    /// # Errors
    ///
    /// A file cannot be read, or is not a memory.
    pub fn load(&self, bus: &mut SimulatedBus) -> Result<(), Error> {
        let names: Vec<String> = bus.motors().iter().map(|motor| motor.name().to_owned()).collect();
        for name in names {
            let file = self.file(&name);
            let memory = match InputFile::open(&file).and_then(|file| file.read_text(BYTES_MAX)) {
                Err(InputError::System(error)) if error.kind() == ErrorKind::NotFound => continue,
                memory => memory.map_err(|error| {
                    Error::new(ErrorKind::InvalidData, format!("{}: {error}", file.display()))
                })?,
            };
            let wrong = |error: InjectError| {
                Error::new(ErrorKind::InvalidData, format!("{}: {error}", file.display()))
            };
            bus.remember(&name, &memory).map_err(wrong)?;
        }
        Ok(())
    }

    /// Writes the memories of `motors` that have changed since the last call. A file holds the old
    /// memory or the new one, never a part.
    ///
    /// # Errors
    ///
    /// A file cannot be written. The next call tries again.
    pub fn save(&mut self, motors: &[Motor]) -> Result<(), Error> {
        for motor in motors {
            let revision = motor.memory_revision();
            if self.kept.get(motor.name()) != Some(&revision) {
                let (file, new) = (self.file(motor.name()), self.folder.join(".new"));
                std::fs::write(&new, motor.memory())?;
                std::fs::rename(&new, file)?;
                self.kept.insert(motor.name().to_owned(), revision);
            }
        }
        Ok(())
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.memory"))
    }
}
