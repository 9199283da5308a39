//! The files that viewers may read: the meshes of the robot.

use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

/// Largest file, bytes.
const FILE_MAX: u64 = 32 << 20;

/// The folder with the packages.
#[derive(Debug)]
pub(crate) struct Assets {
    /// Without symbolic links.
    root: PathBuf,
}

impl Assets {
    /// Opens the folder at `path`.
    pub(crate) fn new(path: &Path) -> Result<Self, String> {
        let root = path.canonicalize().ok().filter(|root| root.is_dir());
        let root = root.ok_or_else(|| format!("[foxglove]: assets {} is no folder", path.display()))?;
        Ok(Self { root })
    }

    /// Returns the file `package://NAME/FILE`. Refuses each file outside the folder, also behind a
    /// symbolic link.
    pub(crate) fn read(&self, uri: &str) -> Result<Vec<u8>, String> {
        let refused = || "there is no such file below `assets` of the bridge".to_owned();
        let relative = Path::new(uri.strip_prefix("package://").ok_or_else(refused)?);
        if !relative.components().all(|part| matches!(part, Component::Normal(_))) {
            return Err(refused());
        }
        let path = self.root.join(relative).canonicalize().map_err(|_| refused())?;
        // Not a pipe or device, whose opening may block.
        if !path.starts_with(&self.root) || !path.is_file() {
            return Err(refused());
        }
        let file = File::open(path).map_err(|_| refused())?;
        let mut content = Vec::new();
        file.take(FILE_MAX + 1).read_to_end(&mut content).map_err(|error| error.to_string())?;
        if content.len() as u64 > FILE_MAX {
            return Err(format!("the file has more than {FILE_MAX} bytes"));
        }
        Ok(content)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder that is removed at the end.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("{name}-{}", std::process::id()));
            std::fs::create_dir_all(path.join("assets/robot")).unwrap();
            std::fs::write(path.join("assets/robot/hip.stl"), "mesh").unwrap();
            std::fs::write(path.join("secret"), "secret").unwrap();
            std::os::unix::fs::symlink(path.join("secret"), path.join("assets/robot/link")).unwrap();
            Self(path)
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            std::fs::remove_dir_all(&self.0).unwrap();
        }
    }

    #[test]
    fn only_files_below_the_folder_are_read() {
        let folder = Folder::new("motord-bridge-assets");
        let assets = Assets::new(&folder.0.join("assets")).unwrap();
        assert_eq!(assets.read("package://robot/hip.stl"), Ok(b"mesh".to_vec()));
        let secret = folder.0.join("secret");
        let absolute = format!("package://{}", secret.display());
        let file = format!("file://{}", secret.display());
        let hostile = [
            "package://../secret",
            "package://robot/../../secret",
            "package:///etc/passwd",
            "package://robot/link",
            "package://robot",
            "package://",
            "package://robot/\0",
            "",
            absolute.as_str(),
            file.as_str(),
        ];
        for uri in hostile {
            assert!(assets.read(uri).is_err(), "{uri}");
        }
    }

    #[test]
    fn folder_must_exist() {
        assert!(Assets::new(Path::new("/missing")).is_err_and(|error| error.contains("/missing")));
    }
}
