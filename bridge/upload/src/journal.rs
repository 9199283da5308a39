//! The progress of each upload: a file for each recording, which survives the process and the computer.

use crate::failure::Failure;
use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

/// A recording and the progress of its upload.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Entry {
    /// Endpoint, bucket and key: another one is another upload.
    pub(crate) destination: String,
    /// Size of the file.
    pub(crate) bytes: u64,
    /// Time of its last change since 1970, ns.
    pub(crate) modified_ns: u64,
    /// SHA-256 of the file, in hexadecimal.
    pub(crate) sha256: String,
    /// The upload that has begun.
    pub(crate) upload: Option<Upload>,
    /// Attempts to complete it that failed.
    pub(crate) completions_failed: u32,
    /// Parts that the store took, in all attempts.
    pub(crate) parts_sent: u64,
    /// The store has the whole file.
    pub(crate) is_complete: bool,
}

/// A multipart upload. The store keeps its parts until it is completed or aborted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Upload {
    pub(crate) id: String,
    /// Size of each part but the last.
    pub(crate) part_bytes: u64,
    /// Identifiers of the parts that the store has, from the first on.
    pub(crate) parts: Vec<String>,
}

/// The folder of the entries. One process at a time has it.
#[derive(Debug)]
pub(crate) struct Journal {
    folder: PathBuf,
    _lock: File,
}

impl Journal {
    /// Opens the folder, and creates it where it is missing.
    ///
    /// # Errors
    ///
    /// The folder cannot be used, or another process has it.
    pub(crate) fn open(folder: &Path) -> Result<Self, Failure> {
        let at = |error| Failure::File { path: folder.to_owned(), error };
        fs::create_dir_all(folder).map_err(at)?;
        let lock = File::create(folder.join("lock")).map_err(at)?;
        lock.try_lock().map_err(|_| Failure::InUse(folder.to_owned()))?;
        Ok(Self { folder: folder.to_owned(), _lock: lock })
    }

    /// Returns the entry of a recording; `None` without a readable one. Then the upload begins anew.
    pub(crate) fn read(&self, name: &str) -> Option<Entry> {
        serde_json::from_slice(&fs::read(self.path(name)).ok()?).ok()
    }

    /// Writes the entry of a recording: completely or not at all.
    ///
    /// # Errors
    ///
    /// The disk does not take it.
    pub(crate) fn write(&self, name: &str, entry: &Entry) -> Result<(), Failure> {
        let (path, unfinished) = (self.path(name), self.folder.join("unfinished"));
        let written = File::create(&unfinished).and_then(|mut file| {
            file.write_all(&serde_json::to_vec(entry)?)?;
            file.sync_all()?;
            fs::rename(&unfinished, &path)?;
            File::open(&self.folder)?.sync_all()
        });
        written.map_err(|error| Failure::File { path, error })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.json"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entry_survives_and_damage_begins_anew() {
        let folder = tempfile::TempDir::new().unwrap();
        let journal = Journal::open(folder.path()).unwrap();
        let upload = Upload { id: "7".into(), part_bytes: 5, parts: vec!["a".into()] };
        let entry = Entry {
            destination: "bucket/run.mcap".into(),
            bytes: 12,
            modified_ns: 3,
            sha256: "00".into(),
            upload: Some(upload),
            completions_failed: 1,
            parts_sent: 1,
            is_complete: false,
        };
        assert_eq!(journal.read("run.mcap"), None);
        journal.write("run.mcap", &entry).unwrap();
        assert_eq!(journal.read("run.mcap"), Some(entry));
        fs::write(folder.path().join("run.mcap.json"), "{").unwrap();
        assert_eq!(journal.read("run.mcap"), None);
        assert!(matches!(Journal::open(folder.path()), Err(Failure::InUse(_))));
    }
}
