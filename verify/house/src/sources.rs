//! The files of the workspace.

use std::path::{Path, PathBuf};

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

/// A file of the workspace.
pub(crate) struct Source {
    /// Relative to the workspace, with `/`.
    pub(crate) path: String,
    pub(crate) text: String,
}

/// The folder of the workspace.
pub(crate) fn root() -> PathBuf {
    Path::new(ROOT).canonicalize().unwrap()
}

/// Every file with one of these endings, in the order of their paths.
pub(crate) fn files(endings: &[&str]) -> Vec<Source> {
    let paths = below(&root());
    let relative = |path: &Path| path.strip_prefix(root()).unwrap().to_str().unwrap().to_owned();
    let mut files: Vec<Source> = paths
        .iter()
        .filter(|path| endings.iter().any(|ending| path.to_string_lossy().ends_with(ending)))
        .map(|path| Source {
            path: relative(path),
            text: String::from_utf8_lossy(&std::fs::read(path).unwrap()).into_owned(),
        })
        .collect();
    files.sort_by(|a, b| a.path.cmp(&b.path));
    files
}

/// The paths of the files below `directory`, without those of builds.
pub(crate) fn below(directory: &Path) -> Vec<PathBuf> {
    let mut paths = Vec::new();
    collect(directory, &mut paths);
    paths
}

/// Every Rust file.
pub(crate) fn rust() -> Vec<Source> {
    files(&[".rs"])
}

fn collect(directory: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() && name != "target" && name != ".git" {
            collect(&path, found);
        } else if path.is_file() {
            found.push(path);
        }
    }
}
