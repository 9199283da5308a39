//! The progress of the trot: in the monitor on a terminal, otherwise line by line.

use crate::demo::controller::TrotProgress;
use crate::monitor::{self, Monitor};
use motord_client::Client;
use std::io::{self, IsTerminal, Write};
use std::sync::Arc;
use std::time::Duration;

/// Time between two lines without a terminal, s.
const LINE_PERIOD: f64 = 1.0;

/// Refreshes of the monitor per second.
const MONITOR_HZ: f64 = 10.0;

/// The output of the progress.
pub(crate) enum Display {
    /// On standard error.
    Line(ProgressLine),
    /// On the whole terminal, with the robot.
    Monitor(Box<Monitor>),
}

impl Display {
    /// Opens the monitor on a terminal, unless the output is for a script; otherwise lines.
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

    /// Updates the monitor for at most `at_most`. Returns false when the user ends it.
    ///
    /// # Errors
    ///
    /// The terminal was closed.
    pub(crate) fn turn(&mut self, at_most: Duration) -> io::Result<bool> {
        match self {
            Self::Line(_) => Ok(true),
            Self::Monitor(monitor) => monitor.turn(at_most),
        }
    }

    /// Returns the wait for the next message: `at_most`, or zero with the monitor, whose turn
    /// already waits.
    pub(crate) fn wait_time(&self, at_most: Duration) -> Duration {
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
    /// Creates the line of a trot of `seconds`.
    pub(crate) fn new(seconds: f64) -> Self {
        Self { seconds, terminal: io::stderr().is_terminal(), next: 0.0 }
    }

    /// Shows `progress`, on a terminal over the last line, otherwise on a new line every
    /// [`LINE_PERIOD`].
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
    /// Clears the line on a terminal, so that the next output begins on a new line.
    fn drop(&mut self) {
        if self.terminal {
            self.write("\r\x1b[K");
        }
    }
}
