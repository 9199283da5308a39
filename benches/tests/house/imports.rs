//! The imports between crates.

use crate::sources;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// Each crate, its imports of ours and of iceoryx2, and the imports of its tests.
const IMPORTS: &[(&str, &[&str], &[&str])] = &[
    ("motord-protocol", &[], &[]),
    ("motord-shared", &["iceoryx2"], &[]),
    ("motord-bus", &[], &["motord-bus"]),
    ("motord-simulator", &["motord-bus"], &["motord-bus", "motord-simulator"]),
    ("motord-settings", &["motord-protocol", "motord-bus", "motord-shared"], &[]),
    (
        "motord-core",
        &["motord-settings", "motord-protocol", "motord-bus", "motord-shared"],
        &["motord-simulator"],
    ),
    (
        "motord-commissioning",
        &["motord-configuration", "motord-protocol", "motord-bus"],
        &["motord-checker", "motord-simulator"],
    ),
    ("motord-configuration", &["motord-core", "motord-protocol", "motord-bus", "motord-shared"], &[]),
    ("motord-realtime", &[], &[]),
    ("motord-metrics", &["motord-bus", "motord-core", "motord-shared"], &[]),
    (
        "motord-deadman",
        &["motord-bus", "motord-configuration", "motord-core", "motord-realtime", "motord-shared"],
        &[],
    ),
    (
        "motord",
        &[
            "motord-commissioning",
            "motord-configuration",
            "motord-core",
            "motord-deadman",
            "motord-realtime",
            "motord-shared",
            "motord-protocol",
            "motord-bus",
            "motord-simulator",
            "motord-metrics",
            "motord-terminal",
        ],
        &["motord-checker"],
    ),
    ("motord-client", &["motord-shared"], &["iceoryx2"]),
    ("motord-frame", &["motord-bus", "motord-configuration", "motord-protocol"], &[]),
    ("motord-terminal", &[], &[]),
    (
        "motord-direct",
        &[
            "motord-commissioning",
            "motord-configuration",
            "motord-core",
            "motord-bus",
            "motord-protocol",
            "motord-terminal",
        ],
        &[],
    ),
    (
        "motord-doctor",
        &["motord-bus", "motord-configuration", "motord-realtime", "motord-settings", "motord-terminal"],
        &[],
    ),
    ("motord-latency", &["motord-client", "motord-terminal"], &[]),
    ("motord-mcap", &["motord-shared"], &[]),
    ("motord-record", &["motord-client", "motord-mcap", "motord-terminal"], &[]),
    (
        "motorctl",
        &[
            "motord-client",
            "motord-doctor",
            "motord-frame",
            "motord-latency",
            "motord-record",
            "motord-simulator",
            "motord-terminal",
            "motord-direct",
        ],
        &["motord-bus", "motord-protocol", "motord-simulator"],
    ),
    // It judges the others, and shares no code with them.
    ("motord-checker", &["motord-bus"], &[]),
];

/// May import anything, and are in no other's list.
const FREE: [&str; 2] = ["motord-benches", "motord-fuzz"];

/// The packages that another program takes in with `motord-core`, procedural macros apart: no command line, no log, no system
/// calls, no shared memory.
const CORE: &[&str] = &[
    "crossbeam-utils",
    "motord-bus",
    "motord-core",
    "motord-protocol",
    "motord-settings",
    "motord-shared",
    "rtrb",
    "serde",
    "serde_core",
    "thiserror",
    "triple_buffer",
];

/// Name, manifest and dependencies of every crate of the workspace.
fn packages() -> Vec<Value> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--no-deps", "--offline", "--format-version", "1"])
        .current_dir(sources::root())
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

/// How the imports of a crate differ from its row: each row is exact, an import that nobody has leaves the table.
fn difference(name: &str, imports: &BTreeSet<&str>, row: &[&str]) -> Vec<String> {
    let row: BTreeSet<&str> = row.iter().copied().collect();
    let forbidden = imports.difference(&row).map(|import| format!("{name} must not import {import}"));
    let unused = row.difference(imports).map(|import| format!("{name} does not import {import} any more"));
    forbidden.chain(unused).collect()
}

#[test]
fn every_crate_imports_what_the_table_says() {
    let packages = packages();
    assert_eq!(packages.len(), IMPORTS.len() + FREE.len(), "the table names every crate");
    for package in packages.iter().filter(|package| !FREE.contains(&text(&package["name"]))) {
        let name = text(&package["name"]);
        let row = IMPORTS.iter().find(|row| row.0 == name);
        let (_, row, in_tests) = row.unwrap_or_else(|| panic!("{name} is not in the table"));
        assert_eq!(difference(name, &imports(package, false), row), [""; 0]);
        assert_eq!(difference(&format!("a test of {name}"), &imports(package, true), in_tests), [""; 0]);
    }
}

#[test]
fn an_import_too_many_and_one_too_few_are_seen() {
    let package = serde_json::json!({ "dependencies": [
        { "name": "motord-bus", "kind": null }, { "name": "iceoryx2-cal", "kind": null },
        { "name": "serde", "kind": null }, { "name": "motord", "kind": "dev" },
    ] });
    let seen = difference("client", &imports(&package, false), &["motord-shared", "iceoryx2"]);
    assert_eq!(seen, ["client must not import motord-bus", "client does not import motord-shared any more"]);
    assert_eq!(difference("client", &imports(&package, true), &["motord"]), [""; 0]);
}

/// Names in the output of `cargo tree`, one package in a line.
fn names(tree: &str) -> Vec<String> {
    let names: BTreeSet<_> = tree.lines().filter_map(|line| line.split(' ').next()).collect();
    names.into_iter().map(str::to_owned).collect()
}

#[test]
fn the_core_brings_into_another_program_nothing_but_what_is_named() {
    let output = Command::new(env!("CARGO"))
        .args(["tree", "--offline", "-p", "motord-core", "-e", "normal,no-proc-macro"])
        .args(["--prefix", "none", "--format", "{p}"])
        .current_dir(sources::root())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(names(&String::from_utf8(output.stdout).unwrap()), CORE);
}

#[test]
fn a_package_below_the_core_is_seen() {
    let tree = "motord-core v0.1.0 (/motord/core)\nrtrb v0.4.1\nclap v4.6.0\nrtrb v0.4.1 (*)\n";
    assert_eq!(names(tree), ["clap", "motord-core", "rtrb"]);
}

#[test]
fn every_crate_keeps_the_lints_of_the_workspace() {
    for package in packages() {
        let manifest = std::fs::read_to_string(text(&package["manifest_path"])).unwrap();
        assert!(manifest.contains("[lints]\nworkspace = true\n"), "{} has lints of its own", package["name"]);
    }
}

/// The cells of each row of the table in a document whose head begins with these cells.
fn rows<'a>(document: &'a str, head: &str) -> Vec<Vec<&'a str>> {
    let table = document.lines().skip_while(|line| !line.starts_with(head)).skip(2);
    let cells = |line: &'a str| line.trim_matches('|').split('|').map(str::trim).collect();
    table.take_while(|line| line.starts_with('|')).map(cells).collect()
}

/// The imports that a document's tables state, by crate. The first table names the crate of each folder, the second has
/// folders: their crates count, and iceoryx2; other words of a cell explain.
fn stated(document: &str) -> BTreeMap<String, BTreeSet<String>> {
    let crates = rows(document, "| folder | crate |");
    let crate_of = |folder: &str| match folder {
        "iceoryx2" => Some(folder.to_owned()),
        _ => {
            let row = crates.iter().find(|row| row[0].trim_matches('`').trim_end_matches('/') == folder);
            row.map(|row| row[1].trim_matches('`').to_owned())
        }
    };
    let imports = |cell: &str| cell.split([',', ' ']).filter_map(crate_of).collect();
    let rows = rows(document, "| crate | may import |");
    let row = |row: Vec<&str>| (crate_of(row[0]).unwrap_or_else(|| panic!("{row:?}")), imports(row[1]));
    rows.into_iter().filter(|row| row[1] != "anything").map(row).collect()
}

#[test]
fn the_table_of_the_architecture_is_the_table_of_this_test() {
    let document = std::fs::read_to_string(sources::root().join("ARCHITECTURE.md")).unwrap();
    let names = |row: &[&str]| row.iter().map(ToString::to_string).collect::<BTreeSet<_>>();
    let table: BTreeMap<_, _> = IMPORTS.iter().map(|row| (row.0.to_owned(), names(row.1))).collect();
    assert_eq!(stated(&document), table);
}

#[test]
fn an_import_that_only_a_document_states_is_seen() {
    let document = "| folder | crate | job |\n|---|---|---|\n| `bus/` | `motord-bus` | |\n| `client/` | `motord-client` | |\n\n\
        | crate | may import | never |\n|---|---|---|\n| bus | | client |\n| client | bus without ports, iceoryx2 | |\n\
        | benches | anything | |\n\nText.\n";
    let stated = stated(document);
    assert_eq!(stated["motord-bus"], BTreeSet::new());
    assert_eq!(stated["motord-client"], BTreeSet::from(["iceoryx2".to_owned(), "motord-bus".to_owned()]));
    assert_eq!(stated.len(), 2);
}
