//! `motorctl instances`: the daemons of this computer.

use crate::failure::Failure;
use motord_client::{DEFAULT_INSTANCE, Listeners, RUNTIME_DIR_VARIABLE, RunningInstance, listeners};
use motord_terminal::{Cell, Palette, Table, json, printable};
use serde::Serialize;
use std::io::{self, Write};

/// A daemon, as `--json` prints it.
#[derive(Debug, Serialize)]
struct Entry {
    /// The instance.
    instance: String,
    /// Its runtime directory.
    runtime_directory: String,
    /// The daemon's process; 0 if unknown.
    pid: u32,
    /// The user that it runs as; 4294967295 if unknown, because its socket takes no connection.
    uid: u32,
    /// Its user is neither root, nor the caller, nor that of the service: it may be no daemon. Only
    /// with `--all`.
    foreign: bool,
    /// The line that shows its state. Empty if foreign.
    command: String,
}

impl Entry {
    fn new(running: RunningInstance, foreign: bool) -> Self {
        // Nothing in the directory of another user is to be opened.
        let command = if foreign { String::new() } else { format!("{} status", line(&running)) };
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
    let Listeners { daemons, foreign: others } = listeners();
    let hidden = if all { 0 } else { others.len() };
    let others = others.into_iter().filter(|_| all).map(|other| Entry::new(other, true));
    let running = daemons.into_iter().map(|running| Entry::new(running, false));
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
            Cell::plain(format!("{}{}", user(entry.uid), if entry.foreign { ", foreign" } else { "" })),
            Cell::plain(&entry.runtime_directory),
            Cell::plain(&entry.command),
        ]);
    }
    table
}

/// Returns the commands for the running daemons as lines to paste; `None` if none runs.
pub(crate) fn instead(verb: &str) -> Option<String> {
    let Listeners { daemons: running, foreign: others } = listeners();
    let mut lines: Vec<String> =
        running.iter().map(|running| format!("  {} {verb}", line(running))).collect();
    if verb == "estop" && !lines.is_empty() {
        lines.push("  motorctl estop --all".to_owned());
    }
    let these = (!lines.is_empty()).then(|| format!("these run:\n{}", lines.join("\n")));
    let others = foreign(verb, &others, &[]);
    let others = (!others.is_empty()).then_some(others);
    match (these, others) {
        (Some(these), Some(others)) => Some(format!("{these}\n{others}")),
        (these, others) => these.or(others),
    }
}

/// Returns a text that names processes of other users, and those of them that did not get a stop;
/// empty without one. Before an `estop` also how to end them. It has no command that would run as
/// one of these users.
pub(crate) fn foreign(verb: &str, reached: &[RunningInstance], unreached: &[RunningInstance]) -> String {
    let total = reached.len() + unreached.len();
    if total == 0 {
        return String::new();
    }
    let ends = verb == "estop";
    let of = |other: &RunningInstance, is_reached: bool| {
        let how = if ends { format!(": {}", remedy(other)) } else { String::new() };
        let not = if is_reached { "" } else { ", NOT REACHED: it takes no connection" };
        format!("\n  {}{not}{how}", listener_of(other))
    };
    let unreached = unreached.iter().map(|other| of(other, false));
    let all = unreached.chain(reached.iter().map(|other| of(other, true)));
    let lines: String = all.take(FOREIGN_MAX).collect();
    let more = match total.checked_sub(FOREIGN_MAX) {
        Some(more @ 1..) => format!("\n  and {more} more: motorctl instances --all"),
        _ => String::new(),
    };
    let end = if ends { " A daemon that is ended damps and stops its motors first" } else { "" };
    let point = if ends { "." } else { "" };
    format!(
        "processes of other users have names of daemons. Their answers do not count{point}{end}:{lines}{more}"
    )
}

/// Returns who listens under the name of a daemon, and which directory it names.
pub(crate) fn listener_of(other: &RunningInstance) -> String {
    let RunningInstance { name, runtime, pid, uid } = other;
    let process = if *pid == 0 { "a process".to_owned() } else { format!("process {pid}") };
    let of = format!("{process} of user {}, instance {name} in {}", user(*uid), runtime.display());
    printable(&of).into_owned()
}

fn user(uid: u32) -> String {
    if uid == u32::MAX { "unknown".to_owned() } else { uid.to_string() }
}

/// Returns how to end a process. Its id counts only while a process of the same user has it: the
/// process may have passed its socket on.
fn remedy(other: &RunningInstance) -> String {
    let RunningInstance { pid, uid, .. } = *other;
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let users = status.lines().find_map(|line| line.strip_prefix("Uid:"));
    if users.is_some_and(|users| users.split_whitespace().all(|user| user.parse() == Ok(uid))) {
        return format!("`sudo kill {pid}`");
    }
    "find it with `sudo ss -xap | grep motord-stop:`, and end it with `sudo kill`".to_owned()
}

/// Returns the beginning of the commands for `running`. Its words need no quotes: see
/// [`Listeners::daemons`].
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

    /// An administrator pastes what is printed in an emergency.
    #[test]
    fn foreign_process_is_ended_by_its_id_only() {
        let of = |pid, uid| RunningInstance { name: "arm".into(), runtime: "/tmp/x".into(), pid, uid };
        let (pid, uid) = (std::process::id(), nix::unistd::Uid::effective().as_raw());
        let text = foreign("estop", &[of(pid, uid), of(pid, uid + 1)], &[of(0, u32::MAX)]);
        let lines: Vec<_> = text.lines().skip(1).collect();
        let search = "find it with `sudo ss -xap | grep motord-stop:`, and end it with `sudo kill`";
        assert_eq!(
            lines,
            [
                format!(
                    "  a process of user unknown, instance arm in /tmp/x, NOT REACHED: it takes no connection: {search}"
                ),
                format!("  process {pid} of user {uid}, instance arm in /tmp/x: `sudo kill {pid}`"),
                format!("  process {pid} of user {}, instance arm in /tmp/x: {search}", uid + 1),
            ]
        );
        assert!(!foreign("status", &[of(pid, uid)], &[]).contains("kill"));
    }
}
