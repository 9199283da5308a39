//! The end of a command.

use crate::failure::Failure;
use crate::instances;
use motord_terminal::printable;
use std::io::{self, Write};
use std::process::ExitCode;

/// Prints the error of a command, and returns its exit status.
pub(crate) fn exit_status_of(outcome: Result<(), Failure>) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) if failure.is_closed_pipe() => ExitCode::SUCCESS,
        Err(failure) if failure.is_printed() => ExitCode::from(failure.status()),
        Err(failure) => {
            eprintln!("motorctl: {}", printable(&failure.to_string()));
            let verb = if matches!(failure, Failure::NotStopped(_)) { "estop" } else { "status" };
            if let Some(others) = failure.is_not_running().then(|| instances::instead(verb)).flatten() {
                eprintln!("motorctl: {}", printable(&others.to_string()));
            }
            ExitCode::from(failure.status())
        }
    }
}

/// Prints the effect of a request. An error of the output is not an error of the command: the
/// request was carried out, and the other groups follow.
pub(crate) fn print_effect(sentence: &str) {
    if let Err(error) = writeln!(io::stdout(), "{}", printable(sentence)) {
        let _closed =
            writeln!(io::stderr(), "motorctl: done, but standard output cannot be written: {error}");
    }
}
