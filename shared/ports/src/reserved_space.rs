//! Reserved space on the disk for the shared memory. Its files are sparse: on a full disk, the
//! kernel kills a process that accesses a page without space (`SIGBUS`). Therefore a daemon
//! reserves the space before it moves anything.

use nix::errno::Errno;
use nix::fcntl::{OFlag, open, posix_fallocate};
use nix::sys::stat::Mode;
use nix::sys::statvfs::statvfs;
use std::fs::{self, File, Metadata};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;

/// The files of a daemon without clients take 4 MB; the rest is for a recorder and the connections
/// of some clients.
pub(crate) const DAEMON_BYTES: i64 = 20 << 20;
/// Upper bound of the files of a client.
const CLIENT_BYTES: u64 = 1 << 20;

/// Checks that `directory` has space for this number of `bytes`, by a temporary reservation.
///
/// # Errors
/// `ENOSPC`; other errors of the kernel.
pub(crate) fn check(directory: &Path, bytes: i64) -> Result<(), Errno> {
    let path = directory.join("space");
    let flags = OFlag::O_CREAT | OFlag::O_TRUNC | OFlag::O_RDWR | OFlag::O_CLOEXEC | OFlag::O_NOFOLLOW;
    let checked =
        open(&path, flags, Mode::S_IRUSR | Mode::S_IWUSR).and_then(|file| posix_fallocate(file, 0, bytes));
    let _left_for_the_next_start = fs::remove_file(&path);
    checked
}

/// Returns `true` when the file system of `directory` has less space than the ports of a client
/// take, or no inode for their files. A file system that cannot be asked is not full.
#[allow(clippy::useless_conversion, reason = "the types have 32 bits on some computers")]
pub(crate) fn is_full(directory: &Path) -> bool {
    statvfs(directory).is_ok_and(|system| {
        let bytes = u64::from(system.blocks_available()).saturating_mul(u64::from(system.fragment_size()));
        // Some file systems have no count of inodes.
        let has_inodes = system.files() == 0 || system.files_available() > 0;
        bytes < CLIENT_BYTES || !has_inodes
    })
}

/// Reserves the space of every file below `directory`, up to its length. A directory that was
/// removed meanwhile needs none.
///
/// # Errors
/// Those of [`check`].
pub(crate) fn occupy(directory: &Path) -> Result<(), Errno> {
    let entries = match fs::read_dir(directory) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(errno)?,
    };
    for entry in entries.flatten() {
        let Ok(metadata) = entry.metadata() else { continue };
        if metadata.is_dir() {
            occupy(&entry.path())?;
        } else if metadata.is_file() && is_sparse(&metadata) {
            occupy_file(&entry.path(), metadata.len())?;
        }
    }
    Ok(())
}

/// Other files must not be opened: closing a file releases every lock of this process on it
/// (`fcntl(2)`). iceoryx2 detects living processes by such locks.
fn is_sparse(metadata: &Metadata) -> bool {
    const BLOCK_BYTES: u64 = 512;
    metadata.blocks() * BLOCK_BYTES < metadata.len()
}

/// Skips a file that was removed meanwhile, is read-only or is a link: this process does not write
/// to it.
fn occupy_file(path: &Path, length: u64) -> Result<(), Errno> {
    let mut options = File::options();
    let Ok(file) = options.write(true).custom_flags(OFlag::O_NOFOLLOW.bits()).open(path) else {
        return Ok(());
    };
    posix_fallocate(file, 0, length.cast_signed())
}

fn errno(error: io::Error) -> Errno {
    Errno::from_raw(error.raw_os_error().unwrap_or(nix::libc::EIO))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};

    #[test]
    fn sparse_file_is_filled_and_keeps_content() {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        let path = directory.path().join("below/file");
        fs::create_dir(path.parent().unwrap()).unwrap();
        fs::write(&path, b"kept").unwrap();
        File::options().write(true).open(&path).unwrap().set_len(1 << 20).unwrap();
        assert!(fs::metadata(&path).unwrap().blocks() * 512 < 1 << 20);
        check(directory.path(), DAEMON_BYTES).unwrap();
        occupy(directory.path()).unwrap();
        assert!(fs::metadata(&path).unwrap().blocks() * 512 >= 1 << 20);
        assert!(fs::read(&path).unwrap().starts_with(b"kept"));
        assert_eq!(
            fs::read_dir(directory.path()).unwrap().count(),
            1,
            "the space that was checked is given back"
        );
    }

    /// A client that connects and disconnects while a daemon starts creates and removes
    /// directories.
    #[test]
    fn a_directory_that_goes_meanwhile_is_no_obstacle() {
        let directory = tempfile::tempdir_in("/tmp").unwrap();
        let ends = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let below = directory.path().join("below");
                while !ends.load(Ordering::Relaxed) {
                    fs::create_dir(&below).unwrap();
                    fs::remove_dir(&below).unwrap();
                }
            });
            let refused = (0..10_000).find_map(|_| occupy(directory.path()).err());
            ends.store(true, Ordering::Relaxed);
            assert_eq!(refused, None);
        });
    }
}
