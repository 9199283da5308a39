//! The progress of the trot: in the monitor for a person at a terminal, else line by line.

use crate::demo::controller::TrotProgress;
use crate::monitor::{self, Monitor};
use motord_client::Client;
use std::io::{self, IsTerminal, Write};
use std::sync::Arc;
use std::time::Duration;

/// Without a terminal a line is written this often, s: enough for a log.
const LINE_PERIOD: f64 = 1.0;

/// Refreshes of the monitor per second.
const MONITOR_HZ: f64 = 10.0;

/// Where the progress is shown.
pub(crate) enum Display {
    /// On standard error.
    Line(ProgressLine),
    /// On the whole terminal, with the robot.
    Monitor(Box<Monitor>),
}

impl Display {
    /// Of a trot of `seconds` on the robot of `client`: the monitor on a terminal, unless the output is for a script.
    ///
    /// # Errors
    ///
    /// When the terminal cannot be set.
    pub(crate) fn open(seconds: f64, client: &Arc<Client>, for_script: bool) -> io::Result<Self> {
        if for_script || !monitor::is_there() {
            return Ok(Self::Line(ProgressLine::new(seconds)));
        }
        let mut monitor = Monitor::open(Arc::clone(client), None, MONITOR_HZ)?;
        monitor.show_progress("demo: the motors are being started".to_owned());
        Ok(Self::Monitor(Box::new(monitor)))
    }

    /// Shows `progress` of a trot of `seconds`.
    pub(crate) fn show(&mut self, progress: &TrotProgress, seconds: f64) {
        match self {
            Self::Line(line) => line.show(progress),
            Self::Monitor(monitor) => monitor.show_progress(format!("demo: {}", sentence(progress, seconds))),
        }
    }

    /// Keeps the monitor going for at most `at_most`; a line needs no time. Returns whether to go on.
    ///
    /// # Errors
    ///
    /// When the terminal is gone.
    pub(crate) fn turn(&mut self, at_most: Duration) -> io::Result<bool> {
        match self {
            Self::Line(_) => Ok(true),
            Self::Monitor(monitor) => monitor.turn(at_most),
        }
    }

    /// How long to wait for the next message: `at_most`, but with the monitor no time, since its turn waits for so long.
    pub(crate) fn patience(&self, at_most: Duration) -> Duration {
        match self {
            Self::Line(_) => at_most,
            Self::Monitor(_) => Duration::ZERO,
        }
    }
}

fn sentence(progress: &TrotProgress, seconds: f64) -> String {
    let TrotProgress { time, cycle, missed, tracking_max } = progress;
    format!(
        "trot {time:.1} of {seconds:.1} s, cycle {cycle}, {missed} missed replies, largest tracking error \
         {tracking_max:.3} rad"
    )
}

/// Shows progress on standard error: standard output is for the result.
#[derive(Debug)]
pub(crate) struct ProgressLine {
    seconds: f64,
    terminal: bool,
    next: f64,
}

impl ProgressLine {
    /// Of a trot that takes `seconds`.
    pub(crate) fn new(seconds: f64) -> Self {
        Self { seconds, terminal: io::stderr().is_terminal(), next: 0.0 }
    }

    /// Shows `progress`: over the last line on a terminal, else now and then on a new line.
    pub(crate) fn show(&mut self, progress: &TrotProgress) {
        if self.terminal {
            self.write(&format!("\r\x1b[K{}", sentence(progress, self.seconds)));
        } else if progress.time >= self.next {
            self.next += LINE_PERIOD;
            self.write(&format!("{}\n", sentence(progress, self.seconds)));
        }
    }

    /// Writes `text`. Ignores an error: progress is optional.
    fn write(&self, text: &str) {
        let _ = io::stderr().write_all(text.as_bytes());
    }
}

impl Drop for ProgressLine {
    /// Takes the line off a terminal: what is said next, good or bad, begins a line of its own.
    fn drop(&mut self) {
        if self.terminal {
            self.write("\r\x1b[K");
        }
    }
}
