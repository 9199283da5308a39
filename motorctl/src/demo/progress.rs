//! One line with the progress of the trot.

use crate::demo::controller::Progress;
use std::io::{self, IsTerminal, Write};

/// Without a terminal a line is written this often, s: enough for a log.
const LINE_PERIOD: f64 = 1.0;

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
    pub(crate) fn show(&mut self, progress: &Progress) {
        if self.terminal {
            self.write(&format!("\r\x1b[K{}", self.line(progress)));
        } else if progress.time >= self.next {
            self.next += LINE_PERIOD;
            self.write(&format!("{}\n", self.line(progress)));
        }
    }

    fn line(&self, progress: &Progress) -> String {
        let Progress { time, cycle, missed, tracking_max } = progress;
        format!(
            "trot {time:.1} of {:.1} s, cycle {cycle}, {missed} missed replies, largest tracking error \
             {tracking_max:.3} rad",
            self.seconds
        )
    }

    /// Progress that nobody can see is no reason to stop.
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
