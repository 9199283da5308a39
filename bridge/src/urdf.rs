//! The URDF, which ROS 2 and viewers get.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Largest URDF, bytes.
const URDF_MAX: u64 = 4 << 20;

/// Reads the file at `path`. The error is a sentence with the path.
pub(crate) fn read(path: &Path) -> Result<String, String> {
    let failed = |reason: &dyn std::fmt::Display| format!("robot-description {}: {reason}", path.display());
    let file = File::open(path).map_err(|error| failed(&error))?;
    let mut bytes = Vec::new();
    file.take(URDF_MAX + 1).read_to_end(&mut bytes).map_err(|error| failed(&error))?;
    if bytes.len() as u64 > URDF_MAX {
        return Err(failed(&format_args!("it has more than {URDF_MAX} bytes")));
    }
    String::from_utf8(bytes).map_err(|error| failed(&error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_file_is_named() {
        let error = read(Path::new("/missing.urdf")).unwrap_err();
        assert!(error.contains("/missing.urdf"), "{error}");
    }

    /// The length of a device is 0.
    #[test]
    fn endless_file_is_refused() {
        let error = read(Path::new("/dev/zero")).unwrap_err();
        assert!(error.contains("/dev/zero") && error.contains("more than 4194304 bytes"), "{error}");
    }
}
