//! Output files in directories where another user may create names.

use std::fs::{self, File};
use std::io;
use std::path::Path;

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
    use std::io::Write;
    use std::os::unix::fs::symlink;

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
