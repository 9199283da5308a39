//! Reads files that any user may have replaced: FIFOs, devices, huge files.

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt, PermissionsExt};
use std::path::Path;

use super::problem::Wrong;

/// Largest file that is read, bytes. 64 motors with every key take a tenth of it.
const FILE_BYTES_MAX: u64 = 1024 * 1024;

/// Returns the bytes of a regular file of bounded size that not every user may write.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, Wrong> {
    // Without O_NONBLOCK the open would wait for a writer if this is a FIFO.
    let file = OpenOptions::new().read(true).custom_flags(nix::libc::O_NONBLOCK).open(path)?;
    admit(&file)?;
    let mut bytes = Vec::new();
    file.take(FILE_BYTES_MAX + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > FILE_BYTES_MAX {
        return Err(Wrong::TooLarge { bytes_max: FILE_BYTES_MAX });
    }
    Ok(bytes)
}

/// Checks the opened file, not its path: the path may lead to another file a moment later.
fn admit(file: &File) -> Result<(), Wrong> {
    let metadata = file.metadata()?;
    let kind = metadata.file_type();
    if kind.is_dir() {
        return Err(Wrong::NotRegular("a directory"));
    }
    if kind.is_fifo() {
        return Err(Wrong::NotRegular("a FIFO"));
    }
    if !kind.is_file() {
        return Err(Wrong::NotRegular("a device or socket"));
    }
    if metadata.permissions().mode() & 0o002 != 0 {
        return Err(Wrong::WorldWritable);
    }
    Ok(())
}

impl From<io::Error> for Wrong {
    fn from(error: io::Error) -> Self {
        Self::Unreadable(error)
    }
}

/// Returns the 64-bit FNV-1a hash of `bytes`. The hash of the standard library differs between versions.
pub(super) fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}
