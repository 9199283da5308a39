//! The exit statuses of every program, from sysexits(3) where it has one, and the command line whose
//! mistakes have one.
//!
//! A client library must not depend on a command line: `motord_client::Error::exit_status` repeats
//! the numbers that it needs.

use clap::Parser;
use motord_untrusted::printable;
use std::fmt::Display;
use std::process::ExitCode;

/// The command was called wrongly, or names a joint or group that does not exist.
pub const USAGE: u8 = 64;
/// A file has mistakes.
pub const DATA: u8 = 65;
/// A daemon, a motor, a bus or a file that the command needs is missing.
pub const UNAVAILABLE: u8 = 69;
/// An internal error: a thread ended.
pub const SOFTWARE: u8 = 70;
/// The operating system refused a resource.
pub const OS: u8 = 71;
/// A file cannot be created.
pub const CANNOT_CREATE: u8 = 73;
/// The output cannot be written.
pub const IO: u8 = 74;
/// A daemon or another tool uses the bus.
pub const BUSY: u8 = 75;
/// The peer speaks another version of the protocol.
pub const PROTOCOL: u8 = 76;
/// The user lacks a permission.
pub const PERMISSION: u8 = 77;
/// A configuration has mistakes.
pub const CONFIG: u8 = 78;
/// An emergency stop was not confirmed. Not a status of sysexits(3), so that no other error looks
/// like it.
pub const NOT_STOPPED: u8 = 79;
/// An emergency stop was confirmed, but motors do not answer. Not a status of sysexits(3).
pub const MOTORS_SILENT: u8 = 80;
/// A signal ended the command: 128 + SIGINT, as a shell reports it.
pub const INTERRUPTED: u8 = 130;

/// Parses the command line.
///
/// # Errors
///
/// The exit status, after help, version or the mistake was printed.
pub fn parse_arguments<A: Parser>() -> Result<A, ExitCode> {
    A::try_parse().map_err(|error| {
        let _unwritable = error.print();
        ExitCode::from(if error.use_stderr() { USAGE } else { 0 })
    })
}

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
