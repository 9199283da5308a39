//! Answered requests on their way from the ipc thread to the log.

use motord_shared::{AdminReply, AdminRequest};
use rtrb::{Consumer, Producer, RingBuffer};

/// Most requests on their way. Further ones are not logged, so that a process that sends requests
/// without pause fills neither memory nor log.
const ASKED_MAX: usize = 64;

/// A request that was answered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Asked {
    /// The newest cycle when it was answered.
    pub(super) cycle: u64,
    pub(super) request: AdminRequest,
    pub(super) reply: AdminReply,
}

/// The ipc thread's end.
pub struct Answered(Producer<Asked>);

impl Answered {
    /// Keeps a request that was answered in `cycle` for the log. Neither allocates nor blocks.
    pub fn note(&mut self, cycle: u64, request: &AdminRequest, reply: AdminReply) {
        let _not_logged = self.0.push(Asked { cycle, request: *request, reply });
    }
}

/// Both ends.
pub(super) fn asked() -> (Answered, Consumer<Asked>) {
    let (producer, consumer) = RingBuffer::new(ASKED_MAX);
    (Answered(producer), consumer)
}
