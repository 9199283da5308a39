//! Input files, whose paths may lead to a FIFO, a device, a directory, or a file that never ends, and
//! output files in directories where another user may create names.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

/// The reason why a file is not read.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    /// The kernel refused.
    #[error(transparent)]
    System(#[from] io::Error),
    /// A directory, FIFO, device or socket.
    #[error("it is {0}: name a regular file")]
    NotRegular(&'static str),
    /// It has more bytes than the limit.
    #[error("it is larger than {bytes_max} bytes")]
    TooLarge {
        /// The limit.
        bytes_max: u64,
    },
    /// It is not UTF-8.
    #[error("it is not UTF-8 text")]
    NotUtf8,
}

impl From<InputError> for io::Error {
    fn from(error: InputError) -> Self {
        let kind = match &error {
            InputError::System(_) => None,
            InputError::NotRegular(_) => Some(io::ErrorKind::InvalidInput),
            InputError::TooLarge { .. } => Some(io::ErrorKind::FileTooLarge),
            InputError::NotUtf8 => Some(io::ErrorKind::InvalidData),
        };
        match (error, kind) {
            (InputError::System(error), _) => error,
            (error, kind) => Self::new(kind.unwrap_or(io::ErrorKind::Other), error.to_string()),
        }
    }
}

/// A regular file that was opened to read.
#[derive(Debug)]
pub struct InputFile {
    file: File,
    metadata: Metadata,
}

impl InputFile {
    /// Opens the file at `path`. Follows links. The opening does not wait for the other end of a
    /// FIFO.
    ///
    /// # Errors
    ///
    /// Those of the system; [`InputError::NotRegular`]. The type is that of the opened file: the
    /// path may lead to another one a moment later.
    pub fn open(path: &Path) -> Result<Self, InputError> {
        let flags = nix::libc::O_NONBLOCK | nix::libc::O_NOCTTY;
        let file = OpenOptions::new().read(true).custom_flags(flags).open(path)?;
        let metadata = file.metadata()?;
        let kind = metadata.file_type();
        match kind.is_file() {
            true => Ok(Self { file, metadata }),
            false if kind.is_dir() => Err(InputError::NotRegular("a directory")),
            false if kind.is_fifo() => Err(InputError::NotRegular("a FIFO")),
            false => Err(InputError::NotRegular("a device or socket")),
        }
    }

    /// Returns the metadata of the opened file.
    #[must_use]
    pub const fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// Returns the file, for a reader that bounds what it reads itself.
    #[must_use]
    pub fn into_file(self) -> File {
        self.file
    }

    /// Reads the whole file. Allocates at most `bytes_max` and one byte, also where the file grows
    /// meanwhile.
    ///
    /// # Errors
    ///
    /// Those of the system; [`InputError::TooLarge`].
    pub fn read(self, bytes_max: u64) -> Result<Vec<u8>, InputError> {
        let mut bytes = Vec::new();
        self.file.take(bytes_max.saturating_add(1)).read_to_end(&mut bytes)?;
        if bytes.len() as u64 > bytes_max {
            return Err(InputError::TooLarge { bytes_max });
        }
        Ok(bytes)
    }

    /// Reads the whole file as text.
    ///
    /// # Errors
    ///
    /// Those of [`read`](Self::read); [`InputError::NotUtf8`].
    pub fn read_text(self, bytes_max: u64) -> Result<String, InputError> {
        String::from_utf8(self.read(bytes_max)?).map_err(|_| InputError::NotUtf8)
    }
}

/// Creates `path` as an empty file to write, in place of what has this name. Follows no link, and
/// opens no FIFO that another user has created there.
///
/// # Errors
///
/// Those of the system.
pub fn recreate(path: &Path) -> io::Result<File> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        Ok(()) | Err(_) => {}
    }
    File::create_new(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nix::sys::stat::Mode;
    use std::io::Write;
    use std::os::unix::fs::symlink;
    use std::os::unix::net::UnixListener;

    #[test]
    fn pipes_and_devices_are_refused_without_wait() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name| directory.path().join(name);
        nix::unistd::mkfifo(&at("fifo"), Mode::S_IRWXU).unwrap();
        let _listener = UnixListener::bind(at("socket")).unwrap();
        for path in ["/dev/zero", "/dev/null", "/proc/self/fd", "/dev/ptmx"] {
            assert!(matches!(InputFile::open(Path::new(path)), Err(InputError::NotRegular(_))), "{path:?}");
        }
        assert!(matches!(InputFile::open(&at("fifo")), Err(InputError::NotRegular("a FIFO"))));
        assert!(InputFile::open(&at("socket")).is_err());
        let missing = InputFile::open(&at("missing")).unwrap_err();
        assert_eq!(io::Error::from(missing).kind(), io::ErrorKind::NotFound);
    }

    #[test]
    fn file_beyond_its_limit_is_refused() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("file");
        std::fs::write(&path, "12345").unwrap();
        let read = |bytes_max| InputFile::open(&path).unwrap().read(bytes_max);
        assert_eq!(read(5).unwrap(), b"12345");
        assert_eq!(read(u64::MAX).unwrap(), b"12345");
        assert!(matches!(read(4), Err(InputError::TooLarge { bytes_max: 4 })));
        // A sparse file of 1 TiB costs as many bytes as may be read.
        std::fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(1 << 40).unwrap();
        assert!(matches!(read(1 << 20), Err(InputError::TooLarge { .. })));
        std::fs::write(&path, [0xE9]).unwrap();
        assert!(matches!(InputFile::open(&path).unwrap().read_text(9), Err(InputError::NotUtf8)));
    }

    #[test]
    fn link_is_replaced_and_not_followed() {
        let directory = tempfile::tempdir().unwrap();
        let [target, link] = ["target", "link"].map(|name| directory.path().join(name));
        fs::write(&target, "of another user").unwrap();
        symlink(&target, &link).unwrap();
        recreate(&link).unwrap().write_all(b"new").unwrap();
        assert_eq!(fs::read_to_string(&target).unwrap(), "of another user");
        assert_eq!(fs::read_to_string(&link).unwrap(), "new");
        assert!(recreate(directory.path()).is_err());
    }
}
