//! `motorctl status`: the state of the robot, once, with the telemetry of its groups.

use crate::failure::Failure;
use crate::report::RobotReport;
use motord_client::{Cause, Client, Error, Lease, Phase, State, Telemetry};
use motord_terminal::{Palette, json, printable};
use std::io::{self, Write};
use std::time::{Duration, Instant};

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

/// Time between two requests of telemetry while no group changes.
const PERIOD: Duration = Duration::from_secs(1);

/// The last telemetry, and the groups at the time of its request.
#[derive(Default)]
pub(crate) struct History {
    telemetry: Telemetry,
    asked: Option<(Instant, u64, Vec<GroupKey>)>,
}

/// Lease, phase and cause of a group. A change makes the telemetry of the group obsolete.
type GroupKey = (Option<Lease>, Option<Phase>, Option<Cause>);

impl History {
    /// Returns telemetry that matches the groups of `state` and is at most a second old. If the
    /// daemon does not answer, it is older or empty.
    pub(crate) fn telemetry(&mut self, client: &Client, state: &State) -> &Telemetry {
        let boot_id = client.description().boot_id;
        let groups = state.groups().map(|group| (group.lease, group.phase, group.cause)).collect();
        let is_known = |(asked, known_id, known): &(Instant, u64, Vec<GroupKey>)| {
            asked.elapsed() < PERIOD && *known_id == boot_id && *known == groups
        };
        if !self.asked.as_ref().is_some_and(is_known) {
            self.asked = Some((Instant::now(), boot_id, groups));
            // Old telemetry is better than none.
            self.telemetry = client.telemetry().unwrap_or_else(|_| std::mem::take(&mut self.telemetry));
        }
        &self.telemetry
    }
}
