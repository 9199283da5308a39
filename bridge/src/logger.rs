//! The log on standard error, which systemd keeps: lines of the bridge, and errors of its
//! libraries, a few a second.
//!
//! ```text
//! each thread ── queue ──▶ thread `log` ── standard error
//! ```
//!
//! Standard error may block, such as that of a stopped terminal. Then lines are lost, and no thread
//! waits: least of all that of the emergency stop.

use crate::rate_limit::RateLimit;
use crate::threads::spawn;
use log::{Level, LevelFilter, Log, Metadata, Record};
use std::io::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Peers can provoke errors of the DDS library with each packet.
static LIBRARIES: Mutex<RateLimit> = Mutex::new(RateLimit::new(5, Duration::from_secs(1)));
/// Limit on lines that wait for standard error.
const LINES_MAX: usize = 1024;
/// Longest time for the lines that wait when the program ends.
const FLUSH: Duration = Duration::from_millis(500);

/// An entry of the queue.
enum Entry {
    Line(String),
    /// All lines before it are written.
    Flushed(SyncSender<()>),
}

struct Logger {
    entries: SyncSender<Entry>,
    /// Lines that found the queue full.
    lost: AtomicU64,
}

impl Logger {
    /// Returns a log, and the lines that are to be written.
    fn new() -> (Self, Receiver<Entry>) {
        let (entries, receiver) = sync_channel(LINES_MAX);
        (Self { entries, lost: AtomicU64::new(0) }, receiver)
    }

    /// Never waits.
    fn add(&self, line: String) {
        let lost = self.lost.swap(0, Ordering::Relaxed);
        let line = if lost > 0 { format!("{line} ({lost} lines before it are lost)") } else { line };
        if self.entries.try_send(Entry::Line(line)).is_err() {
            self.lost.fetch_add(lost + 1, Ordering::Relaxed);
        }
    }
}

/// Starts the log and its thread.
pub(crate) fn start() {
    let (logger, entries) = Logger::new();
    let Ok(_) = spawn("log", move || write(entries, &mut std::io::stderr())) else { return };
    if log::set_boxed_logger(Box::new(logger)).is_ok() {
        log::set_max_level(LevelFilter::Info);
    }
}

/// Writes the lines.
fn write(entries: Receiver<Entry>, output: &mut impl Write) {
    for entry in entries {
        match entry {
            // A log that cannot be written changes nothing else.
            Entry::Line(line) => drop(writeln!(output, "{line}")),
            Entry::Flushed(flushed) => drop(flushed.try_send(())),
        }
    }
}

fn is_ours(metadata: &Metadata) -> bool {
    metadata.target().starts_with("motord_bridge")
}

impl Log for Logger {
    fn enabled(&self, metadata: &Metadata) -> bool {
        metadata.level() <= if is_ours(metadata) { Level::Info } else { Level::Error }
    }

    fn log(&self, record: &Record) {
        if !self.enabled(record.metadata()) {
            return;
        }
        let level = match record.level() {
            Level::Error => "error: ",
            Level::Warn => "warning: ",
            _ => "",
        };
        if is_ours(record.metadata()) {
            self.add(format!("{level}{}", record.args()));
            return;
        }
        let permit = LIBRARIES.lock().unwrap_or_else(PoisonError::into_inner).permit(Instant::now());
        let Some(suppressed) = permit else { return };
        let more = if suppressed > 0 { format!(" ({suppressed} lines suppressed)") } else { String::new() };
        self.add(format!("{level}{}: {}{more}", record.target(), record.args()));
    }

    /// Waits for the lines that were added, at most [`FLUSH`].
    fn flush(&self) {
        let (sender, flushed) = sync_channel(1);
        if self.entries.try_send(Entry::Flushed(sender)).is_ok() {
            let _blocked = flushed.recv_timeout(FLUSH);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocked_output_holds_up_no_thread() {
        let (logger, entries) = Logger::new();
        (0..2 * LINES_MAX).for_each(|number| logger.add(number.to_string()));
        let first = entries.try_iter().take(1).count();
        logger.add("next".to_owned());
        let lines: Vec<_> = entries.try_iter().collect();
        let Some(Entry::Line(last)) = lines.last() else { unreachable!() };
        assert_eq!((first, last.as_str()), (1, "next (1024 lines before it are lost)"));
    }

    #[test]
    fn lines_are_written_in_their_order() {
        let (logger, entries) = Logger::new();
        logger.add("one".to_owned());
        logger.add("two".to_owned());
        let mut output = Vec::new();
        std::thread::scope(|scope| {
            let output = &mut output;
            scope.spawn(move || write(entries, output));
            logger.flush();
            drop(logger);
        });
        assert_eq!(output, b"one\ntwo\n");
    }
}
