//! `motorctl demo`: the real daemon, simulated motors, and a separate controller process.
//!
//! ```text
//! motorctl demo ─┬─ motord run                  in a private runtime directory
//!                └─ motorctl demo-controller    answers every state with setpoints
//! ```
//!
//! Both processes end with the demo in every case. The directory is removed, unless the demo was
//! killed.

mod child;
mod controller;
mod daemon;
pub(crate) mod error;
mod gait;
mod machine;
mod progress;
mod report;
mod tracking;
mod work_directory;

pub(crate) use child::guard;
pub(crate) use controller::run as control;

use crate::failure::CommandFailure;
use child::Child;
use controller::ControllerMessage;
use daemon::Daemon;
use error::{DemoError, SILENCE_MAX};
use machine::ProcessorLoad;
use motord_terminal::{Interrupt, Palette, json};
use progress::Display;
use report::DemoReport;
use serde_json::json;
use std::io::{self, BufRead, BufReader, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};
use tracking::Tracking;
use work_directory::WorkDirectory;

/// Time between two checks of the processes.
const POLL: Duration = Duration::from_millis(50);

/// Reads a duration.
///
/// # Errors
///
/// The text is not a number of seconds from 2 to 3600. In the first second the trot only grows.
pub(crate) fn parse_seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| "expected a number of seconds".to_owned())?;
    if (2.0..=3600.0).contains(&seconds) { Ok(seconds) } else { Err("expected 2 to 3600 seconds".to_owned()) }
}

/// Runs the demo and prints its verdict: `PASS` or `FAIL: reason`, for scripts `"passed"`.
///
/// # Errors
///
/// A step failed, or the run was beyond a limit.
pub(crate) fn run(seconds: f64, config: Option<&Path>, as_json: bool) -> Result<(), DemoError> {
    let overload = ProcessorLoad::read().and_then(ProcessorLoad::overload);
    if let Some(overload) = overload.as_ref().filter(|_| !as_json) {
        eprintln!("motorctl: {overload}: the demo may fail because of it");
    }
    let outcome = play(seconds, config, as_json, overload);
    let out = &mut io::stdout().lock();
    let printed = match (&outcome, as_json) {
        (Err(DemoError::Interrupted), _) => Ok(()),
        (Ok(report), false) => writeln!(out, "{}", report.praise()),
        (Err(error), false) => writeln!(out, "FAIL: {error}"),
        // The report has the verdict.
        (Ok(_) | Err(DemoError::Shortfalls { .. }), true) => Ok(()),
        (Err(error), true) => {
            json::write_line(out, &json!({ "passed": false, "failures": [error.to_string()] }))
        }
    };
    printed.map_err(DemoError::system("write the output"))?;
    match outcome {
        Err(error) if !as_json && !matches!(error, DemoError::Interrupted) => {
            Err(DemoError::Printed(error.status()))
        }
        outcome => outcome.map(drop),
    }
}

fn play(
    seconds: f64,
    config: Option<&Path>,
    as_json: bool,
    overload: Option<String>,
) -> Result<DemoReport, DemoError> {
    let interrupt = Interrupt::register();
    let directory = WorkDirectory::new(config)?;
    let mut daemon = Daemon::start(&directory)?;
    let client = Arc::new(daemon.connect(&interrupt)?);
    let display = Display::open(seconds, &client, as_json).map_err(DemoError::system("use the terminal"))?;
    let tracking = trot(&mut daemon, seconds, display, &interrupt)?;
    let mut report = DemoReport::new(&client.description(), &client.telemetry()?, &tracking);
    let shortfalls = report.conclude(&client.description(), overload.as_deref());
    drop(client);
    daemon.stop()?;

    print(&report, as_json).map_err(DemoError::system("write the output"))?;
    if shortfalls.is_empty() { Ok(report) } else { Err(DemoError::Shortfalls { overload, shortfalls }) }
}

/// Runs the controller, and shows its progress.
fn trot(
    daemon: &mut Daemon<'_>,
    seconds: f64,
    mut display: Display,
    interrupt: &Interrupt,
) -> Result<Vec<Tracking>, DemoError> {
    let mut controller = daemon.start_controller(seconds)?;
    let messages = messages(&mut controller);
    let mut last_message = Instant::now();
    let mut tracking = None;
    loop {
        let goes_on = display.turn(POLL).map_err(DemoError::system("use the terminal"))?;
        if !goes_on || interrupt.is_raised() {
            return Err(DemoError::Interrupted);
        }
        match messages.recv_timeout(display.wait_time(POLL)) {
            Ok(message) => {
                last_message = Instant::now();
                match message {
                    ControllerMessage::TrotProgress(progress) => display.show(&progress, seconds),
                    ControllerMessage::Outcome(outcome) => tracking = Some(outcome),
                }
            }
            Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => {}
        }
        daemon.check()?;
        if last_message.elapsed() > SILENCE_MAX {
            return Err(DemoError::ControllerSilent);
        }
    }
    let status = controller.wait(SILENCE_MAX).map_err(DemoError::system("wait for the controller"))?;
    // If the daemon failed, its log has the cause of the controller's failure.
    daemon.check()?;
    let tracking = tracking.filter(|_| status.success());
    tracking.ok_or_else(|| DemoError::Controller { status, log: daemon.controller_log() })
}

/// Returns the controller's messages. They end at its exit or at a malformed line.
fn messages(controller: &mut Child) -> Receiver<ControllerMessage> {
    let (sender, receiver) = mpsc::channel();
    let output = controller.output();
    std::thread::spawn(move || {
        let lines = output.into_iter().flat_map(|output| BufReader::new(output).lines());
        let messages = lines.map_while(|line| serde_json::from_str(&line.ok()?).ok());
        for message in messages {
            if sender.send(message).is_err() {
                return;
            }
        }
    });
    receiver
}

fn print(report: &DemoReport, as_json: bool) -> io::Result<()> {
    let out = &mut io::stdout().lock();
    if as_json { json::write_line(out, report) } else { report.write(out, Palette::of_stdout()) }
}
