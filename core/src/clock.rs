//! The clock of the cycle: the machine's, or one of virtual time.

pub use motord_bus::{Clock, VirtualClock};
