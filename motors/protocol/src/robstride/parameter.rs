//! Indices of parameters. Source: the vendor's manuals of 2026-04-28, parameter list; the fault
//! register: the manual of the CyberGear.

/// Faults, as in a fault report.
pub const FAULTS: u16 = 0x3022;
/// The id of the host to which the motor sends, one byte.
pub const HOST: u16 = 0x200B;
/// Time without commands after which the motor disables itself: 20 000 is 1 s, 0 is never.
pub const TIMEOUT: u16 = 0x7028;
/// Number of units of [`TIMEOUT`] in a second.
pub const TIMEOUT_HZ: u32 = 20_000;
/// Voltage of the supply, V, a float.
pub const SUPPLY_VOLTAGE: u16 = 0x701C;
