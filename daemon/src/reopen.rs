//! Opens buses again that went away, off the real-time thread.
//!
//! ```text
//!   telemetry ──bus is gone, or stays off──▶ this thread ──opened bus──▶ cycle
//!                                                ▲                         │
//!                                                └────── old bus ──────────┘   (closing it is a system call, too)
//! ```
//!
//! A bus that is back is a bus with stopped motors: nothing is enabled by it.

use crate::buses;
use crate::config::settings::Settings;
use motord_bus::{Bus, Duration};
use motord_shared::limits::BUSES_MAX;
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::mpsc::{Receiver, RecvTimeoutError};

/// The wait after a failed attempt; it doubles up to [`BACK_OFF_MAX`].
const BACK_OFF: Duration = Duration::from_secs(1);
const BACK_OFF_MAX: Duration = Duration::from_secs(8);

/// A bus and its index.
pub type Indexed = (usize, Box<dyn Bus>);

/// The cycle's end.
pub struct Replacements {
    opened: Consumer<Indexed>,
    retired: Producer<Indexed>,
}

/// This thread's end.
pub struct Workshop {
    opened: Producer<Indexed>,
    retired: Consumer<Indexed>,
}

/// Both ends. Allocates; nothing after it does.
#[must_use]
pub fn ends() -> (Replacements, Workshop) {
    let (opened_producer, opened_consumer) = RingBuffer::new(BUSES_MAX);
    let (retired_producer, retired_consumer) = RingBuffer::new(BUSES_MAX);
    (
        Replacements { opened: opened_consumer, retired: retired_producer },
        Workshop { opened: opened_producer, retired: retired_consumer },
    )
}

impl Replacements {
    /// The next opened bus, if one waits and the old one can be given away. Does not allocate or block.
    pub fn take(&mut self) -> Option<Indexed> {
        if self.retired.slots() == 0 { None } else { self.opened.pop().ok() }
    }

    /// Gives an old bus away.
    pub fn retire(&mut self, index: usize, bus: Box<dyn Bus>) {
        // `take` made sure that there is room.
        let _room = self.retired.push((index, bus));
    }
}

impl Workshop {
    /// Opens what `broken` names, until `stop` says so. A bus that cannot be opened is tried again, ever more rarely.
    pub fn run(&mut self, settings: &Settings, broken: &Receiver<usize>, stop: impl Fn() -> bool) {
        let mut waiting: Vec<usize> = Vec::new();
        let mut back_off = BACK_OFF;
        while !stop() {
            match broken.recv_timeout(if waiting.is_empty() { BACK_OFF } else { back_off }) {
                Ok(bus) if !waiting.contains(&bus) => waiting.push(bus),
                Ok(_) | Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            self.close_retired();
            let before = waiting.len();
            waiting.retain(|&bus| !self.reopen(settings, bus));
            let failing = !waiting.is_empty() && waiting.len() == before;
            back_off = if failing { (2 * back_off).min(BACK_OFF_MAX) } else { BACK_OFF };
        }
    }

    fn close_retired(&mut self) {
        while self.retired.pop().is_ok() {}
    }

    /// Gives an opened bus to the cycle. Tells whether there was room.
    pub fn hand_over(&mut self, index: usize, bus: Box<dyn Bus>) -> bool {
        self.close_retired();
        self.opened.push((index, bus)).is_ok()
    }

    fn reopen(&mut self, settings: &Settings, index: usize) -> bool {
        let name = &settings.buses[index].name;
        match buses::open_one(settings, index) {
            Ok(bus) => {
                tracing::warn!(bus = name, "opened again; its motors are stopped until they are enabled");
                self.hand_over(index, bus)
            }
            Err(error) => {
                tracing::warn!("{error}; trying again");
                false
            }
        }
    }
}
