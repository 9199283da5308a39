//! The time in which the daemon is away.

use crate::text::printable;
use std::fmt::Display;

/// Reports once for each time that the daemon is away: repeated messages would only scroll.
#[derive(Debug, Default)]
pub struct Absence {
    reported: bool,
}

impl Absence {
    /// The daemon is away, as `error` says: reports it on standard error, unless it is reported.
    pub fn report(&mut self, error: &impl Display) {
        if !std::mem::replace(&mut self.reported, true) {
            eprintln!("motorctl: {}", printable(&error.to_string()));
            eprintln!("motorctl: waiting for the daemon to return");
        }
    }

    /// The daemon is there: the next absence is reported again.
    pub const fn end(&mut self) {
        self.reported = false;
    }
}
