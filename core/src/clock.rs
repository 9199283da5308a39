//! The clock of the cycle: that of the machine, or virtual time.

pub use motord_bus::{Clock, VirtualClock};
