//! The recordings of a folder that are complete.

use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// The first and the last bytes of a complete MCAP file.
const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// A complete recording.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Recording {
    /// The name of its file.
    pub(crate) name: String,
    pub(crate) path: PathBuf,
    pub(crate) bytes: u64,
    /// Time of its last change since 1970, ns.
    pub(crate) modified_ns: u64,
}

impl Recording {
    /// Returns the recording in a file. `None` for a file that is missing, incomplete or not
    /// regular: the recorder of an incomplete one still writes it, or was killed.
    pub(crate) fn at(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?.to_owned();
        let metadata = fs::symlink_metadata(path).ok().filter(fs::Metadata::is_file)?;
        let modified = metadata.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
        let is_recording = path.extension().is_some_and(|extension| extension == "mcap");
        (is_recording && is_complete(path)).then(|| Self {
            name,
            path: path.to_owned(),
            bytes: metadata.len(),
            modified_ns: u64::try_from(modified.as_nanos()).unwrap_or(u64::MAX),
        })
    }
}

/// Returns the complete recordings of a folder, by name.
///
/// # Errors
///
/// The folder cannot be read.
pub(crate) fn complete(folder: &Path) -> std::io::Result<Vec<Recording>> {
    let entries = fs::read_dir(folder)?;
    let mut found: Vec<_> = entries.filter_map(|entry| Recording::at(&entry.ok()?.path())).collect();
    found.sort();
    Ok(found)
}

fn is_complete(path: &Path) -> bool {
    let ends = || {
        let mut file = File::open(path)?;
        let mut ends = [[0; MAGIC.len()]; 2];
        file.read_exact(&mut ends[0])?;
        file.seek(SeekFrom::End(-(MAGIC.len() as i64)))?;
        file.read_exact(&mut ends[1])?;
        std::io::Result::Ok(ends)
    };
    ends().is_ok_and(|ends| ends == [MAGIC; 2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_complete_regular_recordings_are_found() {
        let folder = tempfile::TempDir::new().unwrap();
        let write =
            |name: &str, parts: &[&[u8]]| fs::write(folder.path().join(name), parts.concat()).unwrap();
        write("b.mcap", &[&MAGIC, b"data", &MAGIC]);
        write("a.mcap", &[&MAGIC, &MAGIC]);
        write("growing.mcap", &[&MAGIC, b"data"]);
        write("short.mcap", &[b"\x89"]);
        write("robot.unfinished", &[&MAGIC, &MAGIC]);
        write("notes.txt", &[b"text"]);
        fs::create_dir(folder.path().join("c.mcap")).unwrap();
        std::os::unix::fs::symlink(folder.path().join("a.mcap"), folder.path().join("link.mcap")).unwrap();
        let names: Vec<_> = complete(folder.path()).unwrap().into_iter().map(|found| found.name).collect();
        assert_eq!(names, ["a.mcap", "b.mcap"]);
    }
}
