//! `motorctl status`: the state of the robot, once.

use crate::failure::Failure;
use crate::history::History;
use crate::report::RobotReport;
use motord_client::{Client, Error};
use motord_terminal::{Palette, json, printable};
use std::io::{self, Write};
use std::time::Duration;

/// Longest wait for a state before a command reports an error.
pub(crate) const TIMEOUT: Duration = Duration::from_millis(300);

/// Connects with [`TIMEOUT`].
///
/// # Errors
///
/// When no daemon answers.
pub(crate) fn connect(instance: &str) -> Result<Client, Error> {
    let client = Client::connect(instance)?;
    client.set_silence(TIMEOUT);
    Ok(client)
}

/// Prints the state of the next cycle; with `check` only its troubles.
///
/// # Errors
///
/// No daemon answers, the output cannot be written, or a check found troubles:
/// [`Failure::Troubled`].
pub(crate) fn run(instance: &str, check: bool, as_json: bool) -> Result<(), Failure> {
    let client = connect(instance)?;
    let state = client.wait(TIMEOUT)?;
    let mut report = RobotReport::new(&client.description(), &state);
    report.add_history(&client.description(), History::default().telemetry(&client, &state));
    let out = &mut io::stdout().lock();
    let troubles = if check { report.troubles() } else { Vec::new() };
    if as_json {
        json::write_line(out, &report)?;
    } else if check {
        troubles.iter().try_for_each(|trouble| writeln!(out, "{}", printable(trouble)))?;
    } else {
        report.write(out, Palette::of_stdout())?;
    }
    if troubles.is_empty() { Ok(()) } else { Err(Failure::Troubled) }
}
