//! `motorctl sim`: faults for simulated motors, buses and IMUs, in a running daemon.

use crate::advice::motorctl;
use crate::failure::Failure;
use motord_client::{Fault, inject_fault};
use motord_simulator::{FaultTarget, Verb};
use motord_terminal::json;
use serde::Serialize;
use std::io::{self, Write};

/// The options of `motorctl sim`.
#[derive(Debug, clap::Args)]
pub(crate) struct Sim {
    /// Name of a motor, a bus or an IMU.
    target: String,
    /// The fault, see below. `ok` ends all faults of the target.
    fault: String,
    /// Its argument, if it has one.
    #[arg(allow_hyphen_values = true)]
    argument: Option<String>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// The object that `--json` prints.
#[derive(Serialize)]
struct InjectedFault<'a> {
    /// The daemon's instance.
    instance: &'a str,
    /// The motor or the bus.
    target: &'a str,
    /// The fault that it has now; `ok`: none any more.
    fault: &'a str,
    /// The argument of the fault, as it was given; null when it has none.
    argument: Option<&'a str>,
}

/// Returns the examples and the list of faults.
pub(crate) fn after_help() -> String {
    let names: Vec<&str> = Fault::ALL.iter().map(|fault| fault.name()).collect();
    format!(
        "Examples:\n  motorctl sim fl-knee off\n  motorctl sim fl-knee ok --json\n  motorctl sim fl-knee fault over-voltage\n  motorctl sim fl-knee ok\n  \
         motorctl sim front-left bus-off\n  motorctl sim front-left ok\n\nFaults of a motor or a bus:\n{}\nFaults of a \
         motor:\n{}\nFaults of a bus:\n{}\nFaults of an IMU:\n  ok, off, gone, stuck, garbage, delayed, intermittent\n\nFaults that a drive may raise, by name, as far as its vendor has them:\n  {}",
        Verb::list(&[FaultTarget::Any]),
        Verb::list(&[FaultTarget::Motor]),
        Verb::list(&[FaultTarget::Bus]),
        names.join(", "),
    )
}

/// Injects the fault. The daemon checks the words.
pub(crate) fn run(instance: &str, sim: &Sim) -> Result<(), Failure> {
    let Sim { target, fault, argument, .. } = sim;
    let line = [target, fault].into_iter().chain(argument).map(String::as_str).collect::<Vec<_>>().join(" ");
    inject_fault(instance, &line)?;
    let out = &mut io::stdout().lock();
    if sim.json {
        json::write_line(out, &InjectedFault { instance, target, fault, argument: argument.as_deref() })?;
    } else if fault == "ok" {
        writeln!(out, "{target}: has no simulated fault now")?;
    } else {
        writeln!(out, "{line}: done; `{} sim {target} ok` ends it", motorctl(instance))?;
    }
    Ok(())
}
