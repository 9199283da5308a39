//! The imports between crates: the table of `ARCHITECTURE.md` is exact, and no crate imports from a
//! higher room.

use crate::sources;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// The top-level folders, lowest first: a crate imports crates of its folder and of folders before
/// it.
const ROOMS: &[&str] = &["shared", "motors", "core", "client", "daemon", "motorctl", "verify", "benches"];

/// The imports that only the tests of a crate have.
const TEST_IMPORTS: &[(&str, &[&str])] = &[
    ("motord", &["motord-checker", "motord-client", "motord-harness"]),
    ("motord-bus", &["motord-bus"]),
    ("motord-client", &["iceoryx2"]),
    ("motord-protocol", &["motord-checker", "motord-protocol", "motord-shared", "motord-simulator"]),
    ("motord-core", &["motord-harness", "motord-simulator"]),
    ("motord-direct", &["motord-simulator"]),
    ("motord-identify", &["motord-configuration", "motord-shared", "motord-twin"]),
    ("motord-simulator", &["motord-bus", "motord-simulator"]),
    ("motorctl", &["motord-bus", "motord-harness", "motord-protocol", "motord-simulator"]),
];

/// The files of core and motors that may re-export items of another crate.
const REEXPORTS_ALLOWED: &[&str] = &[
    // The Python package takes the simulated robot and its faults from one crate.
    "core/twin/src/lib.rs",
];

/// The packages that `motord-core` depends on, without procedural macros: no command line, log,
/// system call or shared memory.
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
    // The reader of the vendors' files, before a cycle starts: toml, and what it needs.
    "serde_spanned",
    "strsim",
    "thiserror",
    "toml",
    "toml_datetime",
    "toml_parser",
    "toml_writer",
    "triple_buffer",
    "winnow",
];

/// A row of the table: the folder of a crate and its imports; `None` for a crate that may import
/// anything.
#[derive(Debug, PartialEq)]
struct Row {
    folder: String,
    imports: Option<BTreeSet<String>>,
}

/// The table of a document, by crate. A cell of imports names crates without `motord-`.
fn table(document: &str) -> BTreeMap<String, Row> {
    let lines = document.lines().skip_while(|line| !line.starts_with("| folder | crate |")).skip(2);
    let row = |line: &str| {
        let cells: Vec<&str> = line.split('|').map(|cell| cell.trim().trim_matches('`')).collect();
        let names = cells[4].split(", ").filter(|name| !name.is_empty()).map(full_name).collect();
        let imports = (cells[4] != "anything").then_some(names);
        (cells[2].to_owned(), Row { folder: cells[1].trim_end_matches('/').to_owned(), imports })
    };
    lines.take_while(|line| line.starts_with('|')).map(row).collect()
}

fn full_name(short: &str) -> String {
    match short {
        "iceoryx2" | "motord" => short.to_owned(),
        _ => format!("motord-{short}"),
    }
}

/// The index in [`ROOMS`] of a crate's folder.
fn room(row: &Row) -> usize {
    let top = row.folder.split('/').next().unwrap();
    ROOMS.iter().position(|room| *room == top).unwrap_or_else(|| panic!("{top} is not in ROOMS"))
}

/// The imports of a table that point to a higher room.
fn upward(table: &BTreeMap<String, Row>) -> Vec<String> {
    let mut found = Vec::new();
    for (name, row) in table {
        let imports = row.imports.iter().flatten().filter_map(|import| Some((import, table.get(import)?)));
        let upward = imports.filter(|(_, imported)| room(imported) > room(row));
        found.extend(upward.map(|(import, _)| format!("{name} must not import {import}")));
    }
    found
}

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

/// The dependencies of `package` that the tables name, in the tests or outside of them.
fn imports(package: &Value, in_tests: bool) -> BTreeSet<String> {
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
        .map(str::to_owned)
        .collect()
}

/// The differences between the imports of a crate and its row. An unused import is a difference.
fn difference(name: &str, imports: &BTreeSet<String>, row: &BTreeSet<String>) -> Vec<String> {
    let forbidden = imports.difference(row).map(|import| format!("{name} must not import {import}"));
    let unused = row.difference(imports).map(|import| format!("{name} does not import {import} any more"));
    forbidden.chain(unused).collect()
}

fn architecture() -> BTreeMap<String, Row> {
    table(&std::fs::read_to_string(sources::root().join("ARCHITECTURE.md")).unwrap())
}

#[test]
fn every_crate_imports_what_the_table_lists() {
    let table = architecture();
    let packages = packages();
    assert_eq!(packages.len(), table.len(), "the table lists every crate");
    for package in &packages {
        let name = text(&package["name"]);
        let row = table.get(name).unwrap_or_else(|| panic!("{name} is not in the table"));
        let folder = sources::root().join(&row.folder).join("Cargo.toml");
        assert_eq!(text(&package["manifest_path"]), folder.to_str().unwrap());
        let Some(row) = &row.imports else { continue };
        assert_eq!(difference(name, &imports(package, false), row), [""; 0]);
        let in_tests = TEST_IMPORTS.iter().find(|row| row.0 == name).map_or(&[][..], |row| row.1);
        let in_tests = in_tests.iter().map(ToString::to_string).collect();
        assert_eq!(difference(&format!("a test of {name}"), &imports(package, true), &in_tests), [""; 0]);
    }
}

#[test]
fn no_crate_imports_from_a_higher_room() {
    let mut table = architecture();
    for package in packages() {
        // Also of a crate that may import anything.
        table.get_mut(text(&package["name"])).unwrap().imports = Some(imports(&package, false));
    }
    assert_eq!(upward(&table), [""; 0]);
}

/// The lines of a file that re-export items of another crate of the workspace.
fn reexports(code: &str) -> Vec<&str> {
    code.lines().map(str::trim).filter(|line| line.starts_with("pub use motord_")).collect()
}

#[test]
fn crates_of_core_and_motors_reexport_no_crate() {
    for source in sources::rust() {
        let is_library = ["core/", "motors/"].iter().any(|room| source.path.starts_with(room));
        if is_library && !REEXPORTS_ALLOWED.contains(&source.path.as_str()) {
            assert_eq!(reexports(&source.text), [""; 0], "{}", source.path);
        }
    }
}

#[test]
fn files_that_reexport_need_it() {
    let file = |path: &&&str| std::fs::read_to_string(sources::root().join(path)).unwrap();
    let unneeded = REEXPORTS_ALLOWED.iter().filter(|path| reexports(&file(path)).is_empty());
    assert_eq!(unneeded.collect::<Vec<_>>(), [&""; 0], "leave REEXPORTS_ALLOWED");
}

#[test]
fn a_reexport_is_found() {
    let code = "use motord_bus::Bus;\n    pub use motord_bus::{Clock, Frame};\npub use clock::Tick;\n";
    assert_eq!(reexports(code), ["pub use motord_bus::{Clock, Frame};"]);
}

#[test]
fn extra_and_unused_imports_are_found() {
    let package = serde_json::json!({ "dependencies": [
        { "name": "motord-bus", "kind": null }, { "name": "iceoryx2-cal", "kind": null },
        { "name": "serde", "kind": null }, { "name": "motord", "kind": "dev" },
    ] });
    let names = |names: &[&str]| names.iter().map(ToString::to_string).collect::<BTreeSet<_>>();
    let found = difference("client", &imports(&package, false), &names(&["motord-shared", "iceoryx2"]));
    assert_eq!(found, ["client must not import motord-bus", "client does not import motord-shared any more"]);
    assert_eq!(difference("client", &imports(&package, true), &names(&["motord"])), [""; 0]);
}

#[test]
fn an_upward_import_is_found() {
    let document = "| folder | crate | job | imports |\n|---|---|---|---|\n| `motors/bus/` | `motord-bus` | | core |\n\
        | `core/` | `motord-core` | | bus, iceoryx2 |\n| `benches/` | `motord-benches` | | anything |\n\nText.\n";
    let table = table(document);
    assert_eq!(upward(&table), ["motord-bus must not import motord-core"]);
    assert_eq!(table["motord-benches"], Row { folder: "benches".to_owned(), imports: None });
}

/// Names in the output of `cargo tree`, one package in a line.
fn names(tree: &str) -> Vec<String> {
    let names: BTreeSet<_> = tree.lines().filter_map(|line| line.split(' ').next()).collect();
    names.into_iter().map(str::to_owned).collect()
}

#[test]
fn core_has_only_the_listed_dependencies() {
    let output = Command::new(env!("CARGO"))
        .args(["tree", "--locked", "-p", "motord-core", "-e", "normal,no-proc-macro"])
        .args(["--prefix", "none", "--format", "{p}"])
        .current_dir(sources::root())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(names(&String::from_utf8(output.stdout).unwrap()), CORE);
}

#[test]
fn a_package_below_core_is_found() {
    let tree = "motord-core v0.1.0 (/motord/core)\nrtrb v0.4.1\nclap v4.6.0\nrtrb v0.4.1 (*)\n";
    assert_eq!(names(tree), ["clap", "motord-core", "rtrb"]);
}

#[test]
fn every_crate_keeps_the_lints_of_the_workspace() {
    for package in packages() {
        let manifest = std::fs::read_to_string(text(&package["manifest_path"])).unwrap();
        assert!(manifest.contains("[lints]\nworkspace = true\n"), "{} has other lints", package["name"]);
    }
}
