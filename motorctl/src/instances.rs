//! `motorctl instances`: the daemons of this computer.

use crate::failure::Failure;
use motord_client::{DEFAULT_INSTANCE, RUNTIME_DIR_VARIABLE, RunningInstance, running_instances};
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
    /// The line that shows its state.
    command: String,
}

impl From<RunningInstance> for Entry {
    fn from(running: RunningInstance) -> Self {
        let command = format!("{} status", line(&running));
        let RunningInstance { name, runtime, pid, uid } = running;
        Self { instance: name, runtime_directory: runtime.display().to_string(), pid, uid, command }
    }
}

/// Prints the daemons that run.
///
/// # Errors
///
/// When the output cannot be written.
pub(crate) fn run(as_json: bool) -> Result<(), Failure> {
    let entries: Vec<Entry> = running_instances().into_iter().map(Entry::from).collect();
    let out = &mut io::stdout().lock();
    if as_json {
        json::write_line(out, &entries)?;
    } else if entries.is_empty() {
        writeln!(out, "no motord runs: start one with `motord run`, or try `motorctl demo`")?;
    } else {
        table(&entries).write(out, Palette::of_stdout())?;
    }
    Ok(())
}

fn table(entries: &[Entry]) -> Table {
    let mut table = Table::new(&["instance", "process", "user id", "runtime directory", "its state"]);
    for entry in entries {
        table.row(vec![
            Cell::plain(&entry.instance),
            Cell::plain(entry.pid),
            Cell::plain(entry.uid),
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
    (!lines.is_empty()).then(|| format!("these run:\n{}", lines.join("\n")))
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
