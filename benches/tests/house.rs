//! The house rules that a compiler does not know: who may import whom, where `unsafe` may be, which lints hold.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// Each crate, what it may import of ours and of iceoryx2, and what its tests may import besides.
const IMPORTS: &[(&str, &[&str], &[&str])] = &[
    ("motord-protocol", &[], &[]),
    ("motord-shared", &["iceoryx2"], &[]),
    ("motord-bus", &[], &["motord-bus"]),
    ("motord-simulator", &["motord-bus"], &["motord-simulator"]),
    ("motord-core", &["motord-protocol", "motord-bus", "motord-shared"], &[]),
    (
        "motord",
        &["motord-core", "motord-shared", "motord-protocol", "motord-bus", "motord-simulator"],
        &["motord-checker"],
    ),
    ("motord-client", &["motord-shared"], &["iceoryx2"]),
    ("motorctl", &["motord-client", "motord-bus", "motord-protocol"], &[]),
    // It judges the others, and shares no code with them.
    ("motord-checker", &["motord-bus"], &[]),
];

/// May import anything, and is in no other's list.
const BENCHES: &str = "motord-benches";

/// Where `unsafe` stands: system calls that no safe crate offers, and the allocators of tests.
const UNSAFE: &[&str] = &[
    "benches/tests/allocations.rs",
    "bus/src/kernel.rs",
    "bus/tests/socketcan/counting.rs",
    "daemon/src/host/kernel.rs",
];

/// Name, manifest and dependencies of every crate of the workspace.
fn packages() -> Vec<Value> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--no-deps", "--offline", "--format-version", "1"])
        .current_dir(ROOT)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    metadata["packages"].as_array().unwrap().clone()
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap()
}

/// Which dependencies of `package` the table speaks of, in the tests or outside of them.
fn imports(package: &Value, in_tests: bool) -> BTreeSet<&str> {
    let dependencies = package["dependencies"].as_array().unwrap();
    let wanted = dependencies.iter().filter(|dependency| (dependency["kind"] == "dev") == in_tests);
    // iceoryx2 is several crates, and counts as one.
    let name = |dependency| match text(dependency) {
        name if name.starts_with("iceoryx2") => "iceoryx2",
        name => name,
    };
    wanted
        .map(|dependency| name(&dependency["name"]))
        .filter(|name| name.starts_with("motor") || *name == "iceoryx2")
        .collect()
}

/// Every Rust file of the workspace.
fn sources(directory: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.ends_with("target") {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn no_crate_imports_what_its_place_in_the_house_forbids() {
    let packages = packages();
    assert_eq!(packages.len(), IMPORTS.len() + 1, "the table names every crate");
    for package in packages.iter().filter(|package| package["name"] != BENCHES) {
        let name = text(&package["name"]);
        let row = IMPORTS.iter().find(|row| row.0 == name);
        let &(_, allowed, in_tests) = row.unwrap_or_else(|| panic!("{name} is not in the table"));
        let allowed: BTreeSet<_> = allowed.iter().copied().collect();
        let forbidden: Vec<_> = imports(package, false).difference(&allowed).copied().collect();
        assert!(forbidden.is_empty(), "{name} imports {forbidden:?}");
        let allowed: BTreeSet<_> = allowed.into_iter().chain(in_tests.iter().copied()).collect();
        let forbidden: Vec<_> = imports(package, true).difference(&allowed).copied().collect();
        assert!(forbidden.is_empty(), "the tests of {name} import {forbidden:?}");
    }
}

#[test]
fn every_crate_keeps_the_lints_of_the_workspace() {
    for package in packages() {
        let manifest = std::fs::read_to_string(text(&package["manifest_path"])).unwrap();
        assert!(manifest.contains("[lints]\nworkspace = true\n"), "{} has lints of its own", package["name"]);
    }
}

#[test]
fn unsafe_code_stands_only_in_the_files_that_are_named_for_it() {
    let root = Path::new(ROOT).canonicalize().unwrap();
    let marks = ["{", "fn", "impl", "extern"].map(|what| ["unsafe", what].join(" "));
    let mut files = Vec::new();
    for package in packages() {
        sources(Path::new(text(&package["manifest_path"])).parent().unwrap(), &mut files);
    }
    files.retain(|path| {
        let source = std::fs::read_to_string(path).unwrap();
        marks.iter().any(|mark| source.contains(mark))
    });
    let found: BTreeSet<_> = files.iter().map(|path| path.strip_prefix(&root).unwrap()).collect();
    assert_eq!(found, UNSAFE.iter().map(Path::new).collect());
}
