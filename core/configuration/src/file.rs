//! Reads files that any user may have replaced: FIFOs, devices, huge files.

use motord_untrusted::{InputError, InputFile};
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use super::problem::{Location, Problem, Wrong};

/// Largest file that is read, bytes. 64 motors with every key take a tenth of it.
const FILE_BYTES_MAX: u64 = 1024 * 1024;

/// Returns the bytes of a regular file of bounded size that not every user may write.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, Wrong> {
    let file = InputFile::open(path)?;
    if file.metadata().permissions().mode() & 0o002 != 0 {
        return Err(Wrong::WorldWritable);
    }
    Ok(file.read(FILE_BYTES_MAX)?)
}

/// Returns the text of the file at `path`, read by the rules of [`load`](crate::load): no FIFO, device or huge
/// file blocks the caller. The file need not be a configuration.
///
/// # Errors
///
/// The problem with the file.
pub fn text(path: &Path) -> Result<String, Problem> {
    let problem = |location, wrong| Problem { file: path.into(), location, wrong };
    let bytes = read(path).map_err(|wrong| problem(None, wrong))?;
    String::from_utf8(bytes).map_err(|error| {
        let location = Location::at(error.as_bytes(), error.utf8_error().valid_up_to(), None);
        problem(Some(location), Wrong::no_utf8(error.as_bytes()))
    })
}

impl From<InputError> for Wrong {
    fn from(error: InputError) -> Self {
        match error {
            InputError::System(error) => Self::Unreadable(error),
            InputError::NotRegular(kind) => Self::NotRegular(kind),
            InputError::TooLarge { bytes_max } => Self::TooLarge { bytes_max },
            InputError::NotUtf8 => Self::NotUtf8,
        }
    }
}

impl From<io::Error> for Wrong {
    fn from(error: io::Error) -> Self {
        Self::Unreadable(error)
    }
}

/// Returns the 64-bit FNV-1a hash of `bytes`. The hash of the standard library differs between
/// versions.
pub(super) fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}
