//! Other users of a CAN interface.

use crate::finding::Finding;
use crate::process;
use crate::tree::Tree;
use motord_bus::{BusLock, Holder};
use nix::unistd::geteuid;
use std::collections::BTreeSet;

/// The receiver lists of the kernel.
const LISTS: [&str; 6] = ["all", "fil", "inv", "sff", "eff", "err"];
/// Kinds of receivers: the last word of a line in these lists.
const KINDS: [&str; 5] = ["raw", "bcm", "isotp", "j1939", "gw"];

const CHECK: &str = "owner";

/// Checks whether another program uses the interface. motord and motorctl lock it; other programs
/// show only filters.
pub(super) fn interface(tree: &Tree, name: &str) -> Finding {
    if let Some(holder) = BusLock::holders_of_interface(name, true).into_iter().flatten().next() {
        return locked(tree, holder).of(name);
    }
    let receivers = receivers(tree, name);
    if receivers.is_empty() {
        return Finding::good(CHECK, "nobody").of(name);
    }
    let kinds: BTreeSet<&str> = receivers.iter().copied().collect();
    let kinds = kinds.into_iter().collect::<Vec<_>>().join(", ");
    let measured = format!("{} filters of other programs ({kinds})", receivers.len());
    let why = "one that only listens, as candump does, is harmless; one that sends commands two masters to the motors";
    Finding::warn(CHECK, measured, why).mended_by("sudo lsof -n | grep CAN_".to_owned()).of(name)
}

/// Checks the process that holds the lock of an interface. Any user may hold a free one, and call
/// the program motord.
fn locked(tree: &Tree, holder: Holder) -> Finding {
    let service = tree.permissions("run/motord").map(|directory| directory.user);
    let is_trusted =
        holder.uid.is_some_and(|uid| [Some(0), Some(geteuid().as_raw()), service].contains(&Some(uid)));
    let program = holder.pid.and_then(|pid| process::program(tree, pid));
    let program = program.as_deref().unwrap_or("unknown program");
    let process = holder.pid.map_or_else(|| "another process".to_owned(), |pid| format!("process {pid}"));
    let user = holder.uid.map(|uid| format!(" of user {uid}")).unwrap_or_default();
    let measured = format!("{program}, {process}{user}");
    match program {
        "motord" if is_trusted => Finding::good(CHECK, measured),
        _ => Finding::warn(CHECK, measured, "motord does not start while it runs"),
    }
}

/// Returns the kinds of the filters on an interface.
fn receivers(tree: &Tree, name: &str) -> Vec<&'static str> {
    let lists = LISTS.iter().filter_map(|list| tree.text(&format!("proc/net/can/rcvlist_{list}")));
    let kind = |line: &str| {
        let mut words = line.split_whitespace();
        let is_on_it = words.next() == Some(name);
        let last = words.last().filter(|_| is_on_it)?;
        KINDS.into_iter().find(|kind| *kind == last)
    };
    lists.flat_map(|text| text.lines().filter_map(kind).collect::<Vec<_>>()).collect()
}
