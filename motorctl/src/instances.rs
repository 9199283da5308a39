//! `motorctl instances`: the daemons of this computer.

use crate::failure::Failure;
use motord_client::{
    DEFAULT_INSTANCE, RUNTIME_DIR_VARIABLE, RunningInstance, foreign_instances, running_instances,
};
use motord_terminal::{Cell, Palette, Table, json};
use serde::Serialize;
use std::io::{self, Write};

/// A daemon, as `--json` prints it.
#[derive(Debug, Serialize)]
struct Entry {
    instance: String,
    runtime_directory: String,
    pid: u32,
    uid: u32,
    /// Its user is neither root, nor this one, nor that of the service. It may be no daemon.
    foreign: bool,
    /// The line that shows its state.
    command: String,
}

impl Entry {
    fn new(running: RunningInstance, foreign: bool) -> Self {
        let command =
            if foreign { line_of_user(&running, "status") } else { format!("{} status", line(&running)) };
        let RunningInstance { name, runtime, pid, uid } = running;
        Self { instance: name, runtime_directory: runtime.display().to_string(), pid, uid, foreign, command }
    }
}

/// Most processes of other users in an error.
const FOREIGN_MAX: usize = 3;

/// Prints the daemons that run, and processes of other users if `all`.
///
/// # Errors
///
/// When the output cannot be written.
pub(crate) fn run(as_json: bool, all: bool) -> Result<(), Failure> {
    let others = foreign_instances();
    let hidden = if all { 0 } else { others.len() };
    let others = others.into_iter().filter(|_| all).map(|other| Entry::new(other, true));
    let running = running_instances().into_iter().map(|running| Entry::new(running, false));
    let entries: Vec<Entry> = running.chain(others).collect();
    let out = &mut io::stdout().lock();
    if as_json {
        json::write_line(out, &entries)?;
        return Ok(());
    }
    if entries.is_empty() {
        writeln!(out, "no motord runs: start one with `motord run`, or try `motorctl demo`")?;
    } else {
        table(&entries).write(out, Palette::of_stdout())?;
    }
    if hidden > 0 {
        writeln!(out, "{hidden} of other users, which may be no daemons: `motorctl instances --all`")?;
    }
    Ok(())
}

fn table(entries: &[Entry]) -> Table {
    let mut table = Table::new(&["instance", "process", "user id", "runtime directory", "its state"]);
    for entry in entries {
        table.row(vec![
            Cell::plain(&entry.instance),
            Cell::plain(entry.pid),
            Cell::plain(format!("{}{}", entry.uid, if entry.foreign { ", foreign" } else { "" })),
            Cell::plain(&entry.runtime_directory),
            Cell::plain(&entry.command),
        ]);
    }
    table
}

/// Returns the commands for the running daemons as lines to paste; `None` if none runs.
pub(crate) fn instead(verb: &str) -> Option<String> {
    let running = running_instances();
    let mut lines: Vec<String> =
        running.iter().map(|running| format!("  {} {verb}", line(running))).collect();
    if verb == "estop" && !lines.is_empty() {
        lines.push("  motorctl estop --all".to_owned());
    }
    let these = (!lines.is_empty()).then(|| format!("these run:\n{}", lines.join("\n")));
    let others = foreign(verb, &foreign_instances());
    let others = (!others.is_empty()).then_some(others);
    match (these, others) {
        (Some(these), Some(others)) => Some(format!("{these}\n{others}")),
        (these, others) => these.or(others),
    }
}

/// Returns a text that names processes of other users, with the commands to run as these; empty without one.
pub(crate) fn foreign(verb: &str, others: &[RunningInstance]) -> String {
    if others.is_empty() {
        return String::new();
    }
    let lines = others.iter().take(FOREIGN_MAX).map(|other| format!("\n  {}", line_of_user(other, verb)));
    let more = match others.len().checked_sub(FOREIGN_MAX) {
        Some(more @ 1..) => format!("\n  and {more} more: motorctl instances --all"),
        _ => String::new(),
    };
    format!(
        "processes of other users have names of daemons. Their answers do not count:{}{more}",
        lines.collect::<String>()
    )
}

/// Returns the command that reaches the daemon of another user as that user.
fn line_of_user(other: &RunningInstance, verb: &str) -> String {
    format!("sudo -u '#{}' {} {verb}", other.uid, line(other))
}

/// Returns the beginning of the commands for `running`. Its words need no quotes: see [`running_instances`].
pub(crate) fn line(running: &RunningInstance) -> String {
    let RunningInstance { name, runtime, .. } = running;
    let directory = match runtime.to_str() {
        Some("/run/motord") => String::new(),
        _ => format!("{RUNTIME_DIR_VARIABLE}={} ", runtime.display()),
    };
    let instance = if name == DEFAULT_INSTANCE { String::new() } else { format!(" --instance {name}") };
    format!("{directory}motorctl{instance}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn daemon_is_reached_by_pasted_line() {
        let of = |name: &str, runtime: &str| {
            line(&RunningInstance { name: name.into(), runtime: runtime.into(), pid: 1, uid: 0 })
        };
        assert_eq!(of(DEFAULT_INSTANCE, "/run/motord"), "motorctl");
        assert_eq!(of("arm", "/tmp/x"), "MOTORD_RUNTIME_DIR=/tmp/x motorctl --instance arm");
    }
}
