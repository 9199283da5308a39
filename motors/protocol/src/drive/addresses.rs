//! The ids of a motor on a bus of frames.

use motord_bus::{FrameId, IdFilter};

/// The ids by which a motor and its host address each other on a bus of frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Addresses {
    /// The id of the frames that command the motor. One from elsewhere is another master's.
    pub commands: FrameId,
    /// The ids of the frames that the motor sends.
    pub replies: IdFilter,
}

impl Addresses {
    /// A motor that is commanded at its `id`, and replies with its host id.
    #[must_use]
    pub fn by_id(id: u8, host_id: FrameId) -> Self {
        Self { commands: FrameId::from(id), replies: IdFilter::exact(host_id) }
    }
}
