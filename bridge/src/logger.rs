//! The log on standard error, which systemd keeps: lines of the bridge, and errors of its
//! libraries, a few a second.

use crate::rate_limit::RateLimit;
use log::{Level, LevelFilter, Log, Metadata, Record};
use std::io::Write;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Peers can provoke errors of the DDS library with each packet.
static LIBRARIES: Mutex<RateLimit> = Mutex::new(RateLimit::new(5, Duration::from_secs(1)));

struct Logger;

/// Starts the log.
pub(crate) fn start() {
    if log::set_logger(&Logger).is_ok() {
        log::set_max_level(LevelFilter::Info);
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
        // A log that cannot be written changes nothing else.
        let _unwritten = if is_ours(record.metadata()) {
            writeln!(std::io::stderr(), "{level}{}", record.args())
        } else {
            let permit = LIBRARIES.lock().unwrap_or_else(PoisonError::into_inner).permit(Instant::now());
            let Some(suppressed) = permit else { return };
            let more =
                if suppressed > 0 { format!(" ({suppressed} lines suppressed)") } else { String::new() };
            writeln!(std::io::stderr(), "{level}{}: {}{more}", record.target(), record.args())
        };
    }

    fn flush(&self) {}
}
