//! A queue of the states of all cycles, for recorders.
//!
//! Wait-free: another thread makes the queue with its messages when a recorder connects, and frees
//! it. The cycle copies each state once.

use motord_shared::StateMessage;
use rtrb::{Consumer, Producer, RingBuffer};

/// Most states in the queue: 96 ms of a 1 kHz cycle. Each takes 9 KB of locked memory.
const WAITING_MAX: usize = 96;

/// The cycle's end of one queue.
struct Queue {
    empty: Consumer<Box<StateMessage>>,
    filled: Producer<Box<StateMessage>>,
}

/// The cycle's end: at most one queue at a time.
pub(super) struct Queues {
    begun: Consumer<Queue>,
    ended: Producer<Queue>,
    queue: Option<Queue>,
}

/// The end of the thread that makes and frees the queues.
pub struct Histories {
    begun: Producer<Queue>,
    ended: Consumer<Queue>,
    is_free: bool,
}

/// The end of the ipc thread: every state, until it is dropped.
pub struct History {
    empty: Producer<Box<StateMessage>>,
    filled: Consumer<Box<StateMessage>>,
}

/// Creates both ends. Allocates.
pub(super) fn histories() -> (Queues, Histories) {
    let (begun_producer, begun_consumer) = RingBuffer::new(1);
    let (ended_producer, ended_consumer) = RingBuffer::new(1);
    (
        Queues { begun: begun_consumer, ended: ended_producer, queue: None },
        Histories { begun: begun_producer, ended: ended_consumer, is_free: true },
    )
}

impl Queues {
    /// Queues a copy of `state` while a recorder is connected. Returns false when the queue is full
    /// and the state is lost. Neither allocates nor frees; wait-free; bounded by joints.
    pub(super) fn put(&mut self, state: &StateMessage) -> bool {
        if self.queue.is_none() {
            self.queue = self.begun.pop().ok();
        }
        if let Some(ended) = self.queue.take_if(|queue| queue.filled.is_abandoned()) {
            // There is one queue at a time, so the ring has space.
            let _never_full = self.ended.push(ended);
        }
        self.queue.as_mut().is_none_or(|queue| queue.put(state))
    }
}

impl Queue {
    fn put(&mut self, state: &StateMessage) -> bool {
        let Ok(mut copy) = self.empty.pop() else { return false };
        copy.copy_from(state);
        // Each ring has space for every message.
        self.filled.push(copy).is_ok()
    }
}

impl Histories {
    /// Frees the last queue if the cycle has returned it. Returns whether another one may begin.
    pub fn is_free(&mut self) -> bool {
        self.is_free |= self.ended.pop().is_ok();
        self.is_free
    }

    /// Makes a queue: the cycle puts its states there from its next cycle on, until the returned
    /// end is dropped. `None` while the last one is not free. Allocates.
    pub fn begin(&mut self) -> Option<History> {
        if !self.is_free() {
            return None;
        }
        let (mut empty_producer, empty) = RingBuffer::new(WAITING_MAX);
        let (filled, filled_consumer) = RingBuffer::new(WAITING_MAX);
        while empty_producer.push(Box::default()).is_ok() {}
        self.is_free = self.begun.push(Queue { empty, filled }).is_err();
        Some(History { empty: empty_producer, filled: filled_consumer })
    }
}

impl History {
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
