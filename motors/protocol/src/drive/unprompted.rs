//! The frames that a motor sends by itself.

use motord_bus::arithmetic::FrameLength;

/// A frame that a motor sends without a request.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnpromptedFrame {
    /// Its length.
    pub length: FrameLength,
    /// From the factory.
    pub rate_hz: f64,
}
