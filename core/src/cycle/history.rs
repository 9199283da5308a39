//! A queue of the states of all cycles, for recorders.
//!
//! Wait-free: messages are allocated at the start and reused, and each state is copied once.

use motord_shared::StateMessage;
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Most states in the queue: 96 ms of a 1 kHz cycle. Each takes 17 KB of locked memory.
const WAITING_MAX: usize = 96;

/// The cycle's end.
pub(super) struct Queue {
    empty: Consumer<Box<StateMessage>>,
    filled: Producer<Box<StateMessage>>,
    is_wanted: Arc<AtomicBool>,
}

/// The end of the ipc thread: every state while a recorder is connected.
pub struct History {
    empty: Producer<Box<StateMessage>>,
    filled: Consumer<Box<StateMessage>>,
    is_wanted: Arc<AtomicBool>,
}

/// Creates both ends. Allocates; nothing after it does.
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
    /// Queues a copy of `state` while a recorder is connected. Returns false when the queue is full
    /// and the state is lost. Wait-free; bounded by joints.
    pub(super) fn put(&mut self, state: &StateMessage) -> bool {
        if !self.is_wanted.load(Ordering::Relaxed) {
            return true;
        }
        let Ok(mut copy) = self.empty.pop() else { return false };
        copy.copy_from(state);
        // Each ring has space for every message.
        self.filled.push(copy).is_ok()
    }
}

impl History {
    /// Sets whether the cycle queues every state, from its next cycle on.
    pub fn want(&self, is_wanted: bool) {
        self.is_wanted.store(is_wanted, Ordering::Relaxed);
    }

    /// Passes every queued state to `show`, oldest first. Does not allocate.
    pub fn take_all(&mut self, mut show: impl FnMut(&StateMessage)) {
        for _ in 0..WAITING_MAX {
            let Ok(state) = self.filled.pop() else { break };
            show(&state);
            // Each ring has space for every message.
            let _never_full = self.empty.push(state);
        }
    }
}
