//! `motorctl status`: the state of the robot, once.

use crate::failure::Failure;
use crate::report::Report;
use motord_client::{Client, Error};
use motord_terminal::{Palette, json};
use std::io;
use std::time::Duration;

/// A shorter silence of the daemon is not reported.
pub(crate) const PATIENCE: Duration = Duration::from_millis(300);

/// Connects a reader with that patience.
///
/// # Errors
///
/// When no daemon answers.
pub(crate) fn connect(instance: &str) -> Result<Client, Error> {
    let client = Client::connect(instance)?;
    client.set_silence(PATIENCE);
    Ok(client)
}

/// Prints the state of the next cycle.
///
/// # Errors
///
/// When no daemon answers, or the output cannot be written.
pub(crate) fn run(instance: &str, as_json: bool) -> Result<(), Failure> {
    let client = connect(instance)?;
    let state = client.wait(PATIENCE)?;
    let mut report = Report::new(&client.description(), &state);
    if report.groups.iter().any(|group| group.stop.as_ref().is_some_and(|stop| stop.asked_by.is_some())) {
        // Who it was is worth a request, and no failure.
        let _unknown = client.telemetry().map(|telemetry| report.name_programs(&telemetry));
    }
    let out = &mut io::stdout().lock();
    if as_json {
        json::write_line(out, &report)?;
    } else {
        report.write(out, Palette::of_stdout())?;
    }
    Ok(())
}
