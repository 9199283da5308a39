//! The command line of a program.

use crate::exit_status;
use clap::Parser;
use std::process::ExitCode;

/// Parses the command line.
///
/// # Errors
///
/// The exit status, after help, version or the mistake was printed.
pub fn parse_arguments<A: Parser>() -> Result<A, ExitCode> {
    A::try_parse().map_err(|error| {
        let _unwritable = error.print();
        ExitCode::from(if error.use_stderr() { exit_status::USAGE } else { 0 })
    })
}
