//! No file has more than 600 lines.

use crate::sources;

/// Lines of a file.
const LINES_MAX: usize = 600;

/// Files with more lines than [`LINES_MAX`].
fn too_long<'a>(files: impl Iterator<Item = (&'a str, &'a str)>) -> Vec<(&'a str, usize)> {
    let lines = files.map(|(path, text)| (path, text.matches('\n').count()));
    lines.filter(|(_, lines)| *lines > LINES_MAX).collect()
}

#[test]
fn no_file_has_more_than_600_lines() {
    let sources = sources::rust();
    let files = sources.iter().map(|source| (source.path.as_str(), source.text.as_str()));
    assert_eq!(too_long(files), []);
}

#[test]
fn a_file_of_601_lines_is_found() {
    let files = [("a.rs", "\n".repeat(600)), ("b.rs", "\n".repeat(601))];
    assert_eq!(too_long(files.iter().map(|(path, text)| (*path, text.as_str()))), [("b.rs", 601)]);
}
