//! Exit statuses, of sysexits(3).

use motord_client::Error;

/// The command was called wrongly, or names a joint or group that does not exist.
pub(crate) const USAGE: u8 = 64;
/// A file with mistakes.
pub(crate) const DATA: u8 = 65;
/// Something that is needed is not there.
pub(crate) const UNAVAILABLE: u8 = 69;
/// The output could not be written.
pub(crate) const IO: u8 = 74;
/// A daemon or another tool uses the bus.
pub(crate) const BUSY: u8 = 75;
/// The user may not.
pub(crate) const PERMISSION: u8 = 77;
/// A configuration with mistakes.
pub(crate) const CONFIG: u8 = 78;
/// Ended by Ctrl-C, as a shell reports it: 128 + SIGINT.
pub(crate) const INTERRUPTED: u8 = 130;

/// The exit status for an error of the client. A refusal comes from a daemon that is there: not 69.
pub(crate) fn of_client(error: &Error) -> u8 {
    match error {
        Error::Refused { .. } => 1,
        error => error.exit_status(),
    }
}
