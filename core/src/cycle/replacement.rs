//! Exchanges disconnected buses for reopened ones.
//!
//! Wait-free. Another thread opens and closes buses, because both may block.

use motord_bus::Bus;
use motord_shared::BusCondition;
use motord_shared::limits::BUSES_MAX;
use rtrb::{Consumer, Producer, RingBuffer};

/// A bus with its index, and its condition at first.
pub(super) type Indexed = (usize, Box<dyn Bus>, BusCondition);

/// The cycle's end.
pub(super) struct Replacements {
    opened: Consumer<Indexed>,
    retired: Producer<Box<dyn Bus>>,
}

/// The end of the thread that opens and closes buses.
pub struct Supply {
    opened: Producer<Indexed>,
    retired: Consumer<Box<dyn Bus>>,
}

/// Creates both ends. Allocates; nothing after it does.
pub(super) fn replacements() -> (Replacements, Supply) {
    let (opened_producer, opened_consumer) = RingBuffer::new(BUSES_MAX);
    let (retired_producer, retired_consumer) = RingBuffer::new(BUSES_MAX);
    (
        Replacements { opened: opened_consumer, retired: retired_producer },
        Supply { opened: opened_producer, retired: retired_consumer },
    )
}

impl Replacements {
    /// Returns the next reopened bus, if any, and if the old one can be returned. Does not allocate
    /// or block.
    pub(super) fn take(&mut self) -> Option<Indexed> {
        if self.retired.slots() == 0 { None } else { self.opened.pop().ok() }
    }

    /// Returns an old bus to the other thread. Does not allocate or block.
    pub(super) fn retire(&mut self, bus: Box<dyn Bus>) {
        // `take` checked that the ring has a free entry.
        let _taken = self.retired.push(bus);
    }
}

impl Supply {
    /// Closes the buses that the cycle returned. May block in the kernel.
    pub fn close_retired(&mut self) {
        while self.retired.pop().is_ok() {}
    }

    /// Passes a reopened bus to the cycle. Returns false when too many are waiting.
    pub fn hand_over(&mut self, index: usize, bus: Box<dyn Bus>) -> bool {
        self.pass(index, bus, BusCondition::Active)
    }

    /// Passes a substitute for a bus that cannot be used, with the condition that the state shows:
    /// [`Gone`](BusCondition::Gone) or [`Exchanged`](BusCondition::Exchanged), in which the cycle
    /// sends nothing. Returns false when too many are waiting.
    pub fn set_aside(&mut self, index: usize, substitute: Box<dyn Bus>, condition: BusCondition) -> bool {
        self.pass(index, substitute, condition)
    }

    fn pass(&mut self, index: usize, bus: Box<dyn Bus>, condition: BusCondition) -> bool {
        self.close_retired();
        self.opened.push((index, bus, condition)).is_ok()
    }
}
