//! The exit status of an error of the client.

use motord_client::Error;
pub(crate) use motord_terminal::exit_status::{INTERRUPTED, IO, UNAVAILABLE, USAGE};

/// The exit status of an error of the client. A refusal comes from a daemon that is there: not 69.
pub(crate) fn of_client(error: &Error) -> u8 {
    match error {
        Error::Refused { .. } => 1,
        error => error.exit_status(),
    }
}
