//! `motorctl demo`: the real daemon, simulated motors, and a controller in a process of its own.
//!
//! ```text
//! motorctl demo ─┬─ motord run                  in a private runtime directory
//!                └─ motorctl demo-controller    answers every state with setpoints
//! ```
//!
//! However the demo ends, both processes end with it. The directory is removed, unless the demo was killed.

mod child;
mod controller;
mod daemon;
mod gait;
mod machine;
mod progress;
mod report;
mod tracking;
mod work_directory;

pub(crate) use child::guard;
pub(crate) use controller::run as control;

use crate::exit_status;
use child::Child;
use controller::{GROUP, Message};
use daemon::Daemon;
use machine::Machine;
use motord_client::{Cause, Error};
use motord_terminal::{Interrupt, Palette, json};
use progress::Display;
use report::{Report, Shortfall};
use serde_json::json;
use std::io::{self, BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};
use tracking::Tracking;
use work_directory::WorkDirectory;

/// The daemon must have its services open within this time.
const READY_MAX: Duration = Duration::from_secs(10);
/// The controller must say something at least this often; finding and starting the motors takes the longest.
const SILENCE_MAX: Duration = Duration::from_secs(20);
/// How often the demo looks whether everybody still runs.
const GLANCE: Duration = Duration::from_millis(50);

/// Why the demo failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DemoError {
    /// The daemon's executable is missing.
    #[error("{} is missing: build it with `cargo build --release --workspace`", .0.display())]
    NoDaemon(PathBuf),
    /// A file or process could not be used.
    #[error("cannot {doing}: {source}")]
    System {
        /// The action that failed.
        doing: &'static str,
        /// Why it failed.
        source: io::Error,
    },
    /// The daemon ended although nobody had asked it to.
    #[error("motord ended with {status}; the end of its log:\n{log}")]
    DaemonEnded {
        /// How.
        status: ExitStatus,
        /// The end of its log.
        log: String,
    },
    /// The daemon runs, but offers no services.
    #[error("motord was not ready after {} s; the end of its log:\n{log}", READY_MAX.as_secs())]
    NotReady {
        /// The end of its log.
        log: String,
    },
    /// The daemon was asked to end, and failed at it.
    #[error("motord ended with {status} when it was stopped; the end of its log:\n{log}")]
    DaemonStop {
        /// How.
        status: ExitStatus,
        /// The end of its log.
        log: String,
    },
    /// The daemon stopped the group in mid-trot.
    #[error("the group {GROUP} was stopped: {}", .0.map_or("no cause is latched", Cause::sentence))]
    Stopped(Option<Cause>),
    /// Motors were not found, started or stopped in time.
    #[error("the group {GROUP} was not {change} within {seconds} s")]
    Slow {
        /// The state that it did not reach.
        change: &'static str,
        /// The time it had, s.
        seconds: f64,
    },
    /// The controller failed.
    #[error("the controller ended with {status}; the end of its log:\n{log}")]
    Controller {
        /// How.
        status: ExitStatus,
        /// The end of its log.
        log: String,
    },
    /// The controller hangs.
    #[error("the controller sent no message for {} s", SILENCE_MAX.as_secs())]
    ControllerSilent,
    /// The daemon cannot be reached.
    #[error(transparent)]
    Client(#[from] Error),
    /// The run ended, but missed a limit.
    #[error("{}", report::failures(.overload.as_deref(), .shortfalls).join("; "))]
    Shortfalls {
        /// A reason of the computer's own, to be told first.
        overload: Option<String>,
        /// The limits.
        shortfalls: Vec<Shortfall>,
    },
    /// It failed with this exit status, and standard output says why.
    #[error("the demo failed")]
    Printed(u8),
    /// A signal ended the demo, for example by Ctrl-C.
    #[error("interrupted; the daemon and its controller are stopped")]
    Interrupted,
}

impl DemoError {
    /// The exit status.
    pub(crate) fn status(&self) -> u8 {
        match self {
            Self::NoDaemon(_) => exit_status::UNAVAILABLE,
            Self::Interrupted => exit_status::INTERRUPTED,
            Self::Printed(status) => *status,
            Self::Client(error) => exit_status::of_client(error),
            _ => 1,
        }
    }

    fn system(doing: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::System { doing, source }
    }
}

/// Reads a duration.
///
/// # Errors
///
/// A sentence, when the text is no number of seconds from 2 to 3600: in the first second the trot is only growing.
pub(crate) fn parse_seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| "expected a number of seconds".to_owned())?;
    if (2.0..=3600.0).contains(&seconds) { Ok(seconds) } else { Err("expected 2 to 3600 seconds".to_owned()) }
}

/// Runs the demo, judges it, and ends with the verdict: `PASS` or `FAIL: why`, for scripts `"passed"`.
///
/// # Errors
///
/// When anything failed, or the run was not good enough.
pub(crate) fn run(seconds: f64, config: Option<&Path>, as_json: bool) -> Result<(), DemoError> {
    let overload = Machine::read().and_then(Machine::overload);
    if let Some(overload) = overload.as_ref().filter(|_| !as_json) {
        eprintln!("motorctl: {overload}: the demo may fail because of it");
    }
    let outcome = play(seconds, config, as_json, overload);
    let out = &mut io::stdout().lock();
    let printed = match (&outcome, as_json) {
        (Err(DemoError::Interrupted), _) => Ok(()),
        (Ok(report), false) => writeln!(out, "{}", report.praise()),
        (Err(error), false) => writeln!(out, "FAIL: {error}"),
        // The report has told it.
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
) -> Result<Report, DemoError> {
    let interrupt = Interrupt::register();
    let directory = WorkDirectory::new(config)?;
    let mut daemon = Daemon::start(&directory)?;
    let client = Arc::new(daemon.connect(&interrupt)?);
    let display = Display::open(seconds, &client, as_json).map_err(DemoError::system("use the terminal"))?;
    let tracking = trot(&mut daemon, seconds, display, &interrupt)?;
    let mut report = Report::new(&client.description(), &client.telemetry()?, &tracking);
    let shortfalls = report.judge(&client.description(), overload.as_deref());
    drop(client);
    daemon.stop()?;

    print(&report, as_json).map_err(DemoError::system("write the output"))?;
    if shortfalls.is_empty() { Ok(report) } else { Err(DemoError::Shortfalls { overload, shortfalls }) }
}

/// Runs the controller, and shows what it tells.
fn trot(
    daemon: &mut Daemon<'_>,
    seconds: f64,
    mut display: Display,
    interrupt: &Interrupt,
) -> Result<Vec<Tracking>, DemoError> {
    let mut controller = daemon.start_controller(seconds)?;
    let messages = messages(&mut controller);
    let mut heard = Instant::now();
    let mut tracking = None;
    loop {
        let goes_on = display.turn(GLANCE).map_err(DemoError::system("use the terminal"))?;
        if !goes_on || interrupt.came() {
            return Err(DemoError::Interrupted);
        }
        match messages.recv_timeout(display.patience(GLANCE)) {
            Ok(message) => {
                heard = Instant::now();
                match message {
                    Message::Progress(progress) => display.show(&progress, seconds),
                    Message::Outcome(outcome) => tracking = Some(outcome),
                }
            }
            Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => {}
        }
        daemon.check()?;
        if heard.elapsed() > SILENCE_MAX {
            return Err(DemoError::ControllerSilent);
        }
    }
    let status = controller.wait(SILENCE_MAX).map_err(DemoError::system("wait for the controller"))?;
    // A controller fails when its daemon does: then the daemon's log has the cause.
    daemon.check()?;
    let tracking = tracking.filter(|_| status.success());
    tracking.ok_or_else(|| DemoError::Controller { status, log: daemon.controller_log() })
}

/// The controller's messages; they end with it. A line that is none ends them too.
fn messages(controller: &mut Child) -> Receiver<Message> {
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

fn print(report: &Report, as_json: bool) -> io::Result<()> {
    let out = &mut io::stdout().lock();
    if as_json { json::write_line(out, report) } else { report.write(out, Palette::of_stdout()) }
}
