//! A file that cannot be read or written.

use crate::exit_status;
use std::io;
use std::path::{Path, PathBuf};

/// A file that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// It cannot be opened or read.
    #[error("cannot read {}: {error}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        error: io::Error,
    },
    /// It cannot be created or written.
    #[error("cannot write {}: {error}", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        error: io::Error,
    },
    /// It exists, and is not replaced.
    #[error("{} exists, and is not replaced: give another name, or remove it", .0.display())]
    Exists(PathBuf),
}

impl FileError {
    /// Returns the constructor of the error that `path` cannot be read.
    pub fn unreadable<E: Into<io::Error>>(path: &Path) -> impl Fn(E) -> Self {
        |error| Self::Unreadable { path: path.to_owned(), error: error.into() }
    }

    /// Returns the constructor of the error that `path` cannot be written.
    pub fn unwritable(path: &Path) -> impl Fn(io::Error) -> Self {
        |error| match error.kind() {
            io::ErrorKind::AlreadyExists => Self::Exists(path.to_owned()),
            _ => Self::Unwritable { path: path.to_owned(), error },
        }
    }

    /// Returns the exit status.
    #[must_use]
    pub const fn exit_status(&self) -> u8 {
        match self {
            Self::Unreadable { .. } => exit_status::DATA,
            Self::Unwritable { .. } | Self::Exists(_) => exit_status::IO,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_that_exists_is_named_as_such() {
        let path = Path::new("/dev/null");
        let error = std::fs::File::create_new(path).map_err(FileError::unwritable(path)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "/dev/null exists, and is not replaced: give another name, or remove it"
        );
    }
}
