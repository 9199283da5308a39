//! Reads the file of a vendor: TOML, with every fact of a [`Profile`].
//!
//! One run reports every problem, each with its place and the remedy. A file that contradicts itself
//! is refused.

mod faults;
mod ids;
mod models;
mod reply;
mod special;
mod table;

pub use table::FileProblem;

use super::Profile;
use table::{Findings, Table, keep, plain};
use toml::de::DeTable;

/// Reads the text of a vendor's file. The profile keeps what it refers to for the life of the
/// process: read a file once.
///
/// # Errors
///
/// Every problem found, in the order of the file. At least one.
pub fn parse(text: &str) -> Result<Profile, Vec<FileProblem>> {
    let (findings, (root, errors)) = (Findings::new(text), DeTable::parse_recoverable(text));
    for error in &errors {
        let message = format!("{}; a key is written as largest = 15, a table as [ids]", error.message());
        findings.add(error.span().map_or(0, |span| span.start), "", message);
    }
    let profile = if errors.is_empty() { profile(&Table::root(&findings, root.get_ref())) } else { None };
    let problems = findings.into_problems();
    profile.filter(|_| problems.is_empty()).ok_or(problems)
}

/// The keys of the file itself.
const KEYS: [&str; 9] =
    ["vendor", "motors", "protocols", "torque-code", "registers", "ids", "special-frames", "reply", "faults"];

/// Reads the whole file. `None` where a part of it cannot be read.
fn profile(root: &Table<'_>) -> Option<Profile> {
    let keys: Vec<_> = KEYS.into_iter().chain(["model"]).collect();
    root.refuse_unknown(&keys);
    let name = root.require("vendor", root.text("vendor"), "give the vendor's name, such as \"damiao\"");
    let name = name.filter(|name| is_name(root, name));
    let motors = root.require("motors", root.text("motors"), "describe the motors, such as \"Damiao DM-J\"");
    let protocols = root.texts("protocols").unwrap_or_else(|| vec!["mit"]);
    let ids = ids::read(&root.section("ids"));
    let reply = root.section("reply");
    let mut layout = reply::read(&reply, ids.as_ref());
    let faults = faults::read(&root.section("faults"), layout.as_mut());
    let special = special::read(&root.section("special-frames"), faults.as_ref());
    let models = models::read(root);
    Some(Profile {
        name: keep(name?),
        motors: keep(motors?),
        protocols: protocols.into_iter().map(keep).collect::<Vec<_>>().leak(),
        ids: ids?,
        special: special?,
        reply: layout?.layout,
        faults: faults?,
        has_registers: root.flag("registers").unwrap_or(false),
        models: models.leak(),
    })
}

/// Reports a name of a vendor that is none.
fn is_name(root: &Table<'_>, name: &str) -> bool {
    let is_letter = |letter: char| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == '-';
    let is_name = (1..=32).contains(&name.len()) && name.chars().all(is_letter);
    if !is_name {
        root.problem("vendor", format!("\"{}\" is no name; use 1 to 32 of a-z, 0-9 and `-`", plain(name)));
    }
    is_name
}
