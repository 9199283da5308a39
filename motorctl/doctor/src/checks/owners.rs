//! Other users of a CAN interface.

use crate::finding::Finding;
use crate::process;
use crate::tree::Tree;
use motord_bus::BusLock;
use std::collections::BTreeSet;

/// The receiver lists of the kernel.
const LISTS: [&str; 6] = ["all", "fil", "inv", "sff", "eff", "err"];
/// Kinds of receivers: the last word of a line in these lists.
const KINDS: [&str; 5] = ["raw", "bcm", "isotp", "j1939", "gw"];

/// Checks whether another program uses the interface. motord and motorctl lock it; other programs
/// show only filters.
pub(super) fn interface(tree: &Tree, name: &str) -> Finding {
    const CHECK: &str = "owner";
    if let Some(holder) = BusLock::holder_of_interface(name) {
        let program = holder.0.and_then(|pid| process::program(tree, pid));
        let program = program.unwrap_or_else(|| "unknown program".to_owned());
        let measured = format!("{program}, {holder}");
        return match program.as_str() {
            "motord" => Finding::good(CHECK, measured),
            _ => Finding::warn(CHECK, measured, "motord does not start while it runs"),
        }
        .of(name);
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
