//! The rooms of `core` and `daemon`: the files and folders below `src`, and which of them may
//! import which.

use crate::circles;
use crate::sources::{self, Source};
use crate::words;
use std::collections::{BTreeMap, BTreeSet};

/// A room and the rooms that it imports. Every row is exact: an unused import is an error.
type Rows = &'static [(&'static str, &'static [&'static str])];

/// `control` decides by capabilities, `drive` makes frames, `cycle` sends them.
const CORE: Rows = &[
    ("control", &[]),
    ("cycle", &["control", "drive", "sensor", "stopper"]),
    ("drive", &[]),
    ("sensor", &["control"]),
    ("stopper", &["drive"]),
];

/// `threads` connects the rooms; `commands` are the subcommands of `motord`.
const DAEMON: Rows = &[
    ("arming", &[]),
    ("buses", &["imus", "plant"]),
    ("commands", &["arming", "buses", "host", "run_error", "threads"]),
    ("host", &[]),
    ("imus", &[]),
    ("ipc", &["imus", "telemetry"]),
    ("plant", &["imus"]),
    ("run_error", &["buses"]),
    ("simulation", &["buses"]),
    ("housekeeping", &[]),
    ("telemetry", &["buses", "housekeeping"]),
    ("emergency_stop", &["telemetry"]),
    (
        "threads",
        &[
            "buses",
            "emergency_stop",
            "host",
            "housekeeping",
            "imus",
            "ipc",
            "plant",
            "run_error",
            "simulation",
            "telemetry",
        ],
    ),
];

/// Where code may name a vendor or its protocols.
const VENDORS_ALLOWED: &[&str] = &[
    // Judges the frames of every vendor, with a separate codec.
    "verify/checker/src",
    "core/configuration/src",
    "motorctl/frame/src",
    // One target per protocol.
    "verify/fuzz/src",
    "motorctl/direct/src",
    "motors/protocol/src",
    "motors/simulator/src",
    // Stores the configured protocol, and decides nothing by it.
    "core/settings/src/settings.rs",
    // Converts the configured protocol to that of the simulator, which shares no type with it.
    "core/twin/src/physics.rs",
];

const VENDORS: &[&str] = &["steadywin", "damiao", "robstride", "cubemars", "myactuator", "gim"];

/// The imports between the rooms of a crate, a row for each room.
fn rooms<'a>(files: impl Iterator<Item = (&'a str, &'a str)>) -> BTreeMap<String, BTreeSet<String>> {
    let mut rooms: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (module, imports) in circles::graph(files) {
        let Some(room) = module.first() else { continue };
        let others = imports.iter().filter_map(|import| import.first()).filter(|other| *other != room);
        rooms.entry(room.clone()).or_default().extend(others.cloned());
    }
    rooms
}

fn table(rows: Rows) -> BTreeMap<String, BTreeSet<String>> {
    rows.iter()
        .map(|(room, others)| ((*room).into(), others.iter().map(ToString::to_string).collect()))
        .collect()
}

/// The vendors that a text of code names.
fn named(code: &str) -> BTreeSet<String> {
    let parts = words::identifiers(code).into_iter().flat_map(|name| words::parts(&name));
    parts
        .map(|part| part.trim_end_matches(|letter: char| letter.is_ascii_digit()).to_owned())
        .filter(|part| VENDORS.contains(&part.as_str()))
        .collect()
}

/// The vendors that a file's code names, where it may not.
fn vendors(source: &Source) -> BTreeSet<String> {
    let is_code = source.path.contains("/src/");
    if !is_code || VENDORS_ALLOWED.iter().any(|prefix| source.path.starts_with(prefix)) {
        return BTreeSet::new();
    }
    named(&source.text)
}

#[test]
fn rooms_of_core_and_daemon_match_tables() {
    let sources = sources::rust();
    assert_eq!(rooms(circles::below_src(&sources, "core")), table(CORE), "core");
    assert_eq!(rooms(circles::below_src(&sources, "daemon")), table(DAEMON), "daemon");
}

#[test]
fn only_the_rooms_for_it_name_a_vendor() {
    for source in sources::rust() {
        assert_eq!(vendors(&source), BTreeSet::new(), "{}", source.path);
    }
}

#[test]
fn every_room_for_vendors_names_one() {
    let sources = sources::rust();
    for prefix in VENDORS_ALLOWED {
        let mut files = sources.iter().filter(|source| source.path.starts_with(prefix));
        assert!(files.any(|source| !named(&source.text).is_empty()), "{prefix} leaves the table");
    }
}

#[test]
fn import_against_the_layers_is_found() {
    let control = [("control/mod.rs", "use crate::drive::Drive;"), ("drive/mod.rs", "")];
    assert_eq!(rooms(control.into_iter())["control"], BTreeSet::from(["drive".to_owned()]));
}

#[test]
fn a_vendor_in_the_wrong_room_is_seen() {
    let source = |path: &str, text: &str| Source { path: path.into(), text: text.into() };
    let bad = "// A GIM motor.\nfn f(motor: Gim8108) -> bool { motor.is_damiao() }";
    let seen = vendors(&source("core/src/control/motor.rs", bad));
    assert_eq!(seen, BTreeSet::from(["gim".to_owned(), "damiao".to_owned()]));
    assert_eq!(vendors(&source("motors/protocol/src/gim/drive.rs", bad)), BTreeSet::new());
}
