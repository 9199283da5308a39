//! The state files of the kernel below a directory: `/` on a robot, a fixture in a test.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Largest processor number plus 1; a larger one is a malformed list.
const PROCESSORS_MAX: usize = 8192;

/// Files below a directory. Unreadable files count as missing.
#[derive(Debug, Clone)]
pub struct Tree {
    root: PathBuf,
}

/// Owner, group and mode of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Permissions {
    pub(crate) user: u32,
    pub(crate) group: u32,
    pub(crate) mode: u32,
}

impl Tree {
    /// Returns the files below `root`.
    #[must_use]
    pub fn below(root: &Path) -> Self {
        Self { root: root.to_owned() }
    }

    fn path(&self, path: &str) -> PathBuf {
        self.root.join(path.trim_start_matches('/'))
    }

    /// Reads a file without trailing white space.
    pub(crate) fn text(&self, path: &str) -> Option<String> {
        let bytes = fs::read(self.path(path)).ok()?;
        Some(String::from_utf8_lossy(&bytes).trim_end().to_owned())
    }

    /// Reads the number in a file.
    pub(crate) fn number(&self, path: &str) -> Option<i64> {
        self.text(path)?.trim().parse().ok()
    }

    /// Reads the processors in a file, such as `0-2,5`; none if the file is missing.
    pub(crate) fn processors(&self, path: &str) -> Vec<usize> {
        processors(&self.text(path).unwrap_or_default())
    }

    pub(crate) fn has(&self, path: &str) -> bool {
        self.path(path).exists()
    }

    /// Returns the names in a directory, sorted.
    pub(crate) fn names(&self, path: &str) -> Vec<String> {
        let entries = fs::read_dir(self.path(path)).into_iter().flatten().flatten();
        let mut names: Vec<_> =
            entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    /// Returns the numeric names in a directory, rising: processes, threads, interrupts.
    pub(crate) fn numbers(&self, path: &str) -> Vec<u32> {
        let mut numbers: Vec<_> = self.names(path).iter().filter_map(|name| name.parse().ok()).collect();
        numbers.sort_unstable();
        numbers
    }

    /// Resolves a symbolic link to a path relative to the tree; `None` if its target is missing or
    /// outside.
    pub(crate) fn resolved(&self, path: &str) -> Option<String> {
        let root = self.root.canonicalize().ok()?;
        let resolved = self.path(path).canonicalize().ok()?;
        Some(resolved.strip_prefix(root).ok()?.to_string_lossy().into_owned())
    }

    /// Returns the text of a symbolic link.
    pub(crate) fn link(&self, path: &str) -> Option<String> {
        Some(fs::read_link(self.path(path)).ok()?.to_string_lossy().into_owned())
    }

    pub(crate) fn permissions(&self, path: &str) -> Option<Permissions> {
        let metadata = fs::metadata(self.path(path)).ok()?;
        Some(Permissions { user: metadata.uid(), group: metadata.gid(), mode: metadata.mode() })
    }
}

/// Parses a processor list of the kernel.
fn processors(list: &str) -> Vec<usize> {
    let range = |part: &str| {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let (first, last): (usize, usize) = (first.trim().parse().ok()?, last.trim().parse().ok()?);
        (last < PROCESSORS_MAX).then_some(first..=last)
    };
    list.split(',').filter_map(range).flatten().collect()
}

/// Formats processors as a list of the kernel, `0-2,5`.
pub(crate) fn list(processors: &[usize]) -> String {
    let mut ranges: Vec<(usize, usize)> = Vec::new();
    for &processor in processors {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == processor => *last = processor,
            _ => ranges.push((processor, processor)),
        }
    }
    let text = |&(first, last): &(usize, usize)| match first == last {
        true => first.to_string(),
        false => format!("{first}-{last}"),
    };
    ranges.iter().map(text).collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_list_survives_reading_and_writing() {
        for text in ["", "0", "0-3", "0-2,5", "1,3,5-7"] {
            assert_eq!(list(&processors(text)), text);
        }
    }

    #[test]
    fn invalid_list_names_nothing_and_allocates_nothing() {
        for text in ["(null)", "5-2", "-", "0-99999999999", "0-4294967295", "a-b,,"] {
            assert_eq!(processors(text), [0_usize; 0], "{text}");
        }
    }
}
