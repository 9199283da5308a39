//! The frames of a sensor on a CAN bus.

use motord_bus::FrameId;

/// The frames of a sensor on a CAN bus, of any kind: for the plan of its bus and for the transport.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorFrames {
    /// Index of its bus.
    pub bus: usize,
    /// Samples in a second.
    pub rate_hz: f64,
    /// Id and bytes of the requests for a sample. None to a sensor that sends by itself.
    pub requests: Vec<(FrameId, u32)>,
    /// Id and bytes of the frames with a sample; of a sensor that is asked, one for each request,
    /// in their order.
    pub samples: Vec<(FrameId, u32)>,
    /// The ids of all frames that it sends.
    pub sent_ids: Vec<FrameId>,
}
