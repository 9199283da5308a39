//! Exit statuses, of sysexits(3).

/// The command was called wrongly, or names a joint or group that does not exist.
pub const USAGE: u8 = 64;
/// A file with mistakes.
pub const DATA: u8 = 65;
/// Something that is needed is not there.
pub const UNAVAILABLE: u8 = 69;
/// The output could not be written.
pub const IO: u8 = 74;
/// A daemon or another tool uses the bus.
pub const BUSY: u8 = 75;
/// The user may not.
pub const PERMISSION: u8 = 77;
/// A configuration with mistakes.
pub const CONFIG: u8 = 78;
/// An emergency stop was not confirmed. No status of sysexits(3): nothing else may be taken for it.
pub const NOT_STOPPED: u8 = 79;
/// Ended by Ctrl-C, as a shell reports it: 128 + SIGINT.
pub const INTERRUPTED: u8 = 130;
