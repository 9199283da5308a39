//! No crate is larger than one person can keep in mind.

use crate::sources::{self, Source};
use std::collections::BTreeMap;

/// Lines of all files below a crate's `src`, unit tests and snapshots included.
const LINES_MAX: usize = 6500;

/// The lines of each folder `src`, by the crate's folder.
fn lines(sources: &[Source]) -> BTreeMap<&str, usize> {
    let mut lines = BTreeMap::new();
    for source in sources {
        if let Some((folder, _)) = source.path.split_once("/src/") {
            *lines.entry(folder).or_default() += source.text.matches('\n').count();
        }
    }
    lines
}

/// The crates that are too large, and their lines.
fn too_large(sources: &[Source]) -> Vec<(&str, usize)> {
    lines(sources).into_iter().filter(|(_, lines)| *lines > LINES_MAX).collect()
}

#[test]
fn no_crate_is_larger_than_one_person_can_keep_in_mind() {
    let sources = sources::files(&[""]);
    assert_eq!(too_large(&sources), []);
}

#[test]
fn a_crate_of_6501_lines_is_found_and_one_of_6500_is_not() {
    let source = |path: &str, lines| Source { path: path.into(), text: "\n".repeat(lines) };
    let crates = |lines| [source("bus/src/a.rs", 6000), source("bus/src/b/c.txt", lines)];
    let other = [source("bus/tests/a.rs", 9000), source("core/src/a.rs", 9000)];
    assert_eq!(too_large(&crates(500)), []);
    assert_eq!(too_large(&crates(501)), [("bus", 6501)]);
    assert_eq!(too_large(&other), [("core", 9000)]);
}
