//! Exit statuses of errors of the client.

use motord_client::Error;
pub(crate) use motord_terminal::exit_status::{
    DATA, INTERRUPTED, IO, MOTORS_SILENT, NOT_STOPPED, UNAVAILABLE, USAGE,
};

/// Returns the exit status of an unconfirmed emergency stop. A missing daemon, a missing permission
/// and a wrong instance name keep their own; every other error gives `NOT_STOPPED`.
pub(crate) fn of_stop(error: &Error) -> u8 {
    match error {
        Error::NotRunning { .. } | Error::Permission { .. } | Error::Instance(_) => error.exit_status(),
        _ => NOT_STOPPED,
    }
}

/// Returns the exit status of an error of the client. A refusal comes from a running daemon: not
/// 69.
pub(crate) fn of_client(error: &Error) -> u8 {
    match error {
        Error::Refused { .. } => 1,
        error => error.exit_status(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_client::Operation;
    use motord_terminal::exit_status::PROTOCOL;

    #[test]
    fn client_errors_have_the_listed_statuses() {
        let version = Error::NotUnderstood { operation: Operation::Claim };
        let missing = Error::NotRunning { instance: "arm".into(), runtime: "/run".into(), died: None };
        let statuses = [Error::OtherClaim, version, missing].map(|error| error.exit_status());
        assert_eq!(statuses, [USAGE, PROTOCOL, UNAVAILABLE]);
    }
}
