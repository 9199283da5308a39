//! Input files.

use std::fs::{self, File};
use std::io;
use std::path::Path;

/// Opens a regular file to read. A pipe or a device may never end, and opening a pipe may block
/// without a limit.
///
/// # Errors
///
/// Those of the system; `InvalidInput` for any other kind of file.
pub fn open_regular(path: &Path) -> io::Result<File> {
    if !fs::metadata(path)?.is_file() {
        let reason = "it is no regular file: save the data to a file first";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
    }
    File::open(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pipes_and_devices_are_refused_without_wait() {
        for path in ["/dev/zero", "/dev/null", "/proc/self/fd", "/dev/tty"] {
            assert!(open_regular(Path::new(path)).is_err(), "{path}");
        }
        let pipe = std::env::temp_dir().join(format!("motord-pipe-{}", std::process::id()));
        assert!(
            std::process::Command::new("mkfifo").arg(&pipe).status().is_ok_and(|status| status.success())
        );
        assert_eq!(
            open_regular(&pipe).map_err(|error| error.kind()).err(),
            Some(io::ErrorKind::InvalidInput)
        );
        assert!(fs::remove_file(&pipe).is_ok());
        assert!(open_regular(&std::env::current_exe().unwrap_or_default()).is_ok());
    }
}
