//! Reports of an unavailable daemon.

use motord_untrusted::printable;
use std::fmt::Display;

/// Reports an unavailable daemon once, not on every failed attempt.
#[derive(Debug, Default)]
pub struct Absence {
    reported: bool,
}

impl Absence {
    /// Prints `error` on standard error, unless this absence was reported already.
    pub fn report(&mut self, error: &impl Display) {
        if !std::mem::replace(&mut self.reported, true) {
            eprintln!("motorctl: {}", printable(&error.to_string()));
            eprintln!("motorctl: waiting for the daemon to restart");
        }
    }

    /// Ends the absence: the next one is reported again.
    pub const fn end(&mut self) {
        self.reported = false;
    }
}
