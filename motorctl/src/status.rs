//! `motorctl status`: how the robot is, once.

use crate::failure::Failure;
use crate::json;
use crate::report::Report;
use crate::table::Palette;
use motord_client::Client;
use std::io;
use std::time::Duration;

/// States come once a cycle; a daemon that is silent for this long is gone.
pub(crate) const PATIENCE: Duration = Duration::from_secs(1);

/// Prints the state of the next cycle.
///
/// # Errors
///
/// When no daemon answers, or the output cannot be written.
pub(crate) fn run(instance: &str, as_json: bool) -> Result<(), Failure> {
    let mut client = Client::connect(instance)?;
    let state = client.wait(PATIENCE)?;
    let report = Report::new(client.roster(), &state);
    let out = &mut io::stdout().lock();
    if as_json {
        json::write_line(out, &report)?;
    } else {
        report.write(out, Palette::of_stdout())?;
    }
    Ok(())
}
