//! A doc comment begins with its subject.

use crate::sources;

/// The lines of a Rust file that begin a doc comment with "What".
fn vague(text: &str) -> Vec<usize> {
    let is_vague =
        |line: &str| ["/// What ", "//! What "].iter().any(|start| line.trim_start().starts_with(start));
    text.lines().enumerate().filter(|(_, line)| is_vague(line)).map(|(at, _)| at + 1).collect()
}

#[test]
fn no_doc_line_begins_with_what() {
    for source in sources::rust() {
        assert_eq!(vague(&source.text), [0_usize; 0], "{}: name the subject", source.path);
    }
}

#[test]
fn vague_doc_line_is_found() {
    let bad = concat!("/// The", " time.\n    /// What", " it does.\n//! What", " this is.\n// What now?\n");
    assert_eq!(vague(bad), [2, 3]);
}
