//! A doc comment begins with its subject.

use crate::sources;

/// The lines of a Rust file that begin a doc comment with "What".
fn vague(text: &str) -> Vec<usize> {
    let is_vague =
        |line: &str| ["/// What ", "//! What "].iter().any(|start| line.trim_start().starts_with(start));
    text.lines().enumerate().filter(|(_, line)| is_vague(line)).map(|(at, _)| at + 1).collect()
}

/// Folders whose comments are not rewritten yet.
const NOT_YET: &[&str] = &["motorctl/", "protocol/", "simulator/"];

#[test]
fn no_doc_line_begins_with_what() {
    let is_due = |path: &str| !NOT_YET.iter().any(|folder| path.starts_with(folder));
    for source in sources::rust().iter().filter(|source| is_due(&source.path)) {
        assert_eq!(vague(&source.text), [0_usize; 0], "{}: name the subject", source.path);
    }
}

#[test]
fn a_doc_line_that_begins_with_what_is_found() {
    let bad = concat!("/// The", " time.\n    /// What", " it does.\n//! What", " this is.\n// What now?\n");
    assert_eq!(vague(bad), [2, 3]);
}
