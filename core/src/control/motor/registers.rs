//! The registers of a motor that are read before its group may start.
//!
//! Codes are fractions of the ends that a Damiao motor has in its registers, so a state has no meaning until they are
//! read. A request takes the place of the command of a stopped motor, at most one in a turn.
//!
//! ```text
//!              every value read, all in range
//!   Unknown ─────────────────────────────────▶ Known ──restart suspected, or the bus was opened again──▶ Expired
//!      ▲  ▲                                    │   ▲                                                       │ │
//!      │  └───── silence ──────────────────────┘   └────────── every value read, all in range ─────────────┘ │
//!      └────────────────────────────── silence, or a value out of range ─────────────────────────────────────┘
//! ```
//!
//! States are used while `Known` or `Expired`. Only a `Known` motor starts, and it is never asked.

use crate::settings::{MotorSettings, REGISTERS_MAX, RegisterRange};
use motord_bus::{Duration, Instant};

/// Requests in a row without an answer after which the motor counts as one that does not report its registers.
const TRIES: u32 = 5;
/// Interval between later requests, and between two readings of a motor with a value out of range.
const RETRY: Duration = Duration::from_secs(1);

/// The registers of one motor, as far as they are known.
#[derive(Debug)]
pub(super) struct Registers {
    count: u8,
    knowledge: Knowledge,
    /// Number of the register to be read next.
    next: u8,
    pub(super) values: [f32; REGISTERS_MAX],
    /// The first register whose value is out of range, after all were read.
    pub(super) wrong: Option<u8>,
    /// Requests since the last answer.
    tries: u32,
    /// The next request is due at this time.
    due: Instant,
    /// The values that were reported last.
    reported: Option<[f32; REGISTERS_MAX]>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Knowledge {
    Unknown,
    Expired,
    Known,
}

impl Registers {
    pub(super) fn new(settings: &MotorSettings) -> Self {
        let count = settings.capabilities.registers.min(REGISTERS_MAX as u8);
        Self {
            count,
            knowledge: if count == 0 { Knowledge::Known } else { Knowledge::Unknown },
            next: 0,
            values: [0.0; REGISTERS_MAX],
            wrong: None,
            tries: 0,
            due: Instant::ZERO,
            reported: None,
        }
    }

    /// Forgets everything: after its silence the motor may be another one.
    pub(super) const fn forget(&mut self) {
        if self.count > 0 {
            self.knowledge = Knowledge::Unknown;
            (self.next, self.wrong, self.tries) = (0, None, 0);
            (self.due, self.reported) = (Instant::ZERO, None);
        }
    }

    /// Requires another reading. The values hold until then.
    pub(super) const fn expire(&mut self) {
        if matches!(self.knowledge, Knowledge::Known) && self.count > 0 {
            self.knowledge = Knowledge::Expired;
            (self.next, self.tries, self.due) = (0, 0, Instant::ZERO);
        }
    }

    pub(super) const fn is_known(&self) -> bool {
        matches!(self.knowledge, Knowledge::Known)
    }

    /// Returns the register to request at `now`, and whether the motor has just become one that does not report them.
    pub(super) fn request(&mut self, now: Instant) -> Option<(u8, bool)> {
        if self.is_known() || now < self.due {
            return None;
        }
        self.tries = self.tries.saturating_add(1);
        if self.tries > TRIES {
            self.due = now + RETRY;
        }
        Some((self.next, self.tries == TRIES + 1))
    }

    /// Takes the value of a register. Returns whether it is the last one.
    pub(super) fn take(&mut self, number: u8, value: f32) -> bool {
        if self.is_known() || number != self.next {
            return false;
        }
        self.values[usize::from(number)] = value;
        (self.tries, self.due) = (0, Instant::ZERO);
        self.next = (number + 1) % self.count;
        self.next == 0
    }

    /// Decides, after all were read by `now`, whether every value is in its range.
    pub(super) fn check(&mut self, ranges: &[RegisterRange; REGISTERS_MAX], now: Instant) {
        let mut values = self.values[..usize::from(self.count)].iter().zip(ranges);
        let wrong = values.position(|(value, range)| !range.contains(*value));
        self.wrong = wrong.map(|number| number as u8);
        self.knowledge = if wrong.is_none() { Knowledge::Known } else { Knowledge::Unknown };
        self.due = if wrong.is_none() { Instant::ZERO } else { now + RETRY };
    }

    /// Returns whether the values have no meaning.
    pub(super) const fn is_unknown(&self) -> bool {
        matches!(self.knowledge, Knowledge::Unknown)
    }

    /// Returns whether the values are other ones than those that were reported last, and records that they are reported.
    pub(super) fn take_change(&mut self) -> bool {
        let bits = |values: [f32; REGISTERS_MAX]| values.map(f32::to_bits);
        self.reported.replace(self.values).map(bits) != Some(bits(self.values))
    }
}
