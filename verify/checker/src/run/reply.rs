//! A received frame.

use motord_bus::{Frame, Instant};

/// A frame to the host, as recorded on the wire.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reply {
    /// The end of the frame.
    pub at: Instant,
    /// Index of the bus.
    pub bus: usize,
    /// Id and bytes.
    pub frame: Frame,
}
