//! `motorctl watch`: the state of the robot, repeatedly, also across restarts of the daemon.

use crate::failure::Failure;
use crate::report::RobotReport;
use crate::status;
use crate::status::History;
use motord_client::{Client, State};
use motord_terminal::{Absence, Interrupt, Palette, json, within};
use std::io::{self, Write};
use std::time::{Duration, Instant};

/// Reads refreshes per second.
///
/// # Errors
///
/// A sentence, when the text is no number from 0.1 to 100.
pub(crate) fn parse_hz(text: &str) -> Result<f64, String> {
    within(text, 0.1, 100.0)
}

/// Prints the newest state `hz` times a second until a signal arrives.
///
/// # Errors
///
/// No daemon runs at the start, or the output cannot be written. Later the daemon may restart.
pub(crate) fn run(instance: &str, hz: f64, as_json: bool) -> Result<(), Failure> {
    let interrupt = Interrupt::register();
    let client = status::connect(instance)?;
    let period = Duration::from_secs_f64(1.0 / hz);
    let mut output = Output::new(as_json);
    let mut next = Instant::now();
    while !interrupt.is_raised() {
        match client.wait(status::TIMEOUT) {
            Ok(state) => output.show(&client, &state)?,
            Err(error) => output.absence.report(&error),
        }
        next = (next + period).max(Instant::now());
        interrupt.pause_until(next);
    }
    Ok(())
}

/// The output of the refreshes.
struct Output {
    as_json: bool,
    palette: Palette,
    absence: Absence,
    history: History,
}

impl Output {
    fn new(as_json: bool) -> Self {
        Self {
            as_json,
            palette: Palette::of_stdout(),
            absence: Absence::default(),
            history: History::default(),
        }
    }

    fn show(&mut self, client: &Client, state: &State) -> Result<(), Failure> {
        self.absence.end();
        let robot = client.description();
        let mut report = RobotReport::new(&robot, state);
        report.add_history(&robot, self.history.telemetry(client, state));
        let mut text = Vec::new();
        if self.as_json {
            json::write_line(&mut text, &report)?;
        } else {
            report.write(&mut text, self.palette)?;
            writeln!(text)?;
        }
        let out = &mut io::stdout().lock();
        out.write_all(&text)?;
        Ok(out.flush()?)
    }
}
