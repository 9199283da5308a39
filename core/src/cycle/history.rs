//! The states of all cycles, for recorders, on their way to the ipc thread.
//!
//! Wait-free: the messages are made at the start and go back and forth, so that nothing is allocated and each state is copied once.

use motord_shared::StateMessage;
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// States that wait for the ipc thread at most: 128 ms of a 1 kHz cycle.
const WAITING_MAX: usize = 128;

/// The cycle's end.
pub(super) struct Queue {
    empty: Consumer<Box<StateMessage>>,
    filled: Producer<Box<StateMessage>>,
    is_wanted: Arc<AtomicBool>,
}

/// The other end: every state while somebody wants it.
pub struct History {
    empty: Producer<Box<StateMessage>>,
    filled: Consumer<Box<StateMessage>>,
    is_wanted: Arc<AtomicBool>,
}

/// Makes both ends. Allocates; nothing after it does.
pub(super) fn history() -> (Queue, History) {
    let (mut empty_producer, empty_consumer) = RingBuffer::new(WAITING_MAX);
    let (filled_producer, filled_consumer) = RingBuffer::new(WAITING_MAX);
    while empty_producer.push(Box::default()).is_ok() {}
    let is_wanted = Arc::new(AtomicBool::new(false));
    (
        Queue { empty: empty_consumer, filled: filled_producer, is_wanted: Arc::clone(&is_wanted) },
        History { empty: empty_producer, filled: filled_consumer, is_wanted },
    )
}

impl Queue {
    /// Hands a copy of `state` over where it is wanted. Returns false when so many wait already that this one is lost.
    /// Wait-free; bounded by joints.
    pub(super) fn put(&mut self, state: &StateMessage) -> bool {
        if !self.is_wanted.load(Ordering::Relaxed) {
            return true;
        }
        let Ok(mut copy) = self.empty.pop() else { return false };
        copy.copy_from(state);
        // There are as many places as messages.
        self.filled.push(copy).is_ok()
    }
}

impl History {
    /// From its next cycle on, the cycle hands over every state, or none.
    pub fn want(&self, is_wanted: bool) {
        self.is_wanted.store(is_wanted, Ordering::Relaxed);
    }

    /// Shows every state that waits, oldest first. Does not allocate.
    pub fn take_all(&mut self, mut show: impl FnMut(&StateMessage)) {
        for _ in 0..WAITING_MAX {
            let Ok(state) = self.filled.pop() else { break };
            show(&state);
            // There are as many places as messages.
            let _never_full = self.empty.push(state);
        }
    }
}
