//! The registers of a motor that are read before its group may start.
//!
//! Codes are fractions of the ends that a Damiao motor has in its registers, so a state has no
//! meaning until they are read. A request takes the place of the command of a stopped motor, at
//! most one in a turn.
//!
//! ```text
//!              every value read, all in range
//!   Unknown ─────────────────────────────────▶ Known ──restart suspected, or the bus was opened again──▶ Expired
//!      ▲  ▲                                    │   ▲                                                       │ │
//!      │  └───── silence ──────────────────────┘   └────────── every value read, all in range ─────────────┘ │
//!      └────────────────────────────── silence, or a value out of range ─────────────────────────────────────┘
//!
//!   Unknown, Expired ──no answer for RETRY, every value is written──▶ Assumed ──answer, or silence──▶ Unknown
//! ```
//!
//! Nothing is assumed of a motor that reported a value out of range, until all its values are read
//! and in range.
//!
//! States are used unless `Unknown`. A `Known` or `Assumed` motor starts. A `Known` one is not
//! asked; an `Assumed` one is asked while it is stopped.

use motord_bus::{Duration, Instant};
use motord_settings::settings::{MotorSettings, REGISTERS_MAX, RegisterRange};

/// Requests in consecutive turns. The next ones are [`RETRY`] apart, and the motor is stopped in
/// between.
const TRIES: u32 = 5;
/// Without an answer to this request the motor counts as one that does not report its registers: a
/// bus that was disturbed for some turns is no reason.
const LAST_TRY: u32 = TRIES + 2;
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
    /// A register whose value was out of range when it was last read; after all were read, the
    /// first one. A silence does not clear it.
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
    Assumed,
    Known,
}

impl Registers {
    pub(super) fn new(settings: &MotorSettings) -> Self {
        Self::of(settings.capabilities.registers.min(REGISTERS_MAX as u8))
    }

    const fn of(count: u8) -> Self {
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

    /// Requires another reading of everything: after its silence the motor may be another one. A
    /// value out of range still forbids to assume values: it may as well be the same motor.
    pub(super) const fn forget(&mut self) {
        if self.count > 0 {
            self.knowledge = Knowledge::Unknown;
            (self.next, self.tries) = (0, 0);
            (self.due, self.reported) = (Instant::ZERO, None);
        }
    }

    /// Requires another reading. The values hold until then.
    pub(super) const fn expire(&mut self) {
        if self.permits_start() && self.count > 0 {
            self.knowledge = Knowledge::Expired;
            (self.next, self.tries, self.due) = (0, 0, Instant::ZERO);
        }
    }

    /// Returns whether the values are read and in range, or assumed.
    pub(super) const fn permits_start(&self) -> bool {
        matches!(self.knowledge, Knowledge::Known | Knowledge::Assumed)
    }

    /// Returns the register to request at `now`, and whether the motor has just become one that
    /// does not report them.
    pub(super) fn request(&mut self, now: Instant) -> Option<(u8, bool)> {
        if matches!(self.knowledge, Knowledge::Known) || now < self.due {
            return None;
        }
        self.tries = self.tries.saturating_add(1);
        if self.tries > TRIES {
            self.due = now + RETRY;
        }
        Some((self.next, self.tries == LAST_TRY))
    }

    /// Uses the written values of a motor that answered no request. Returns whether it did: it does
    /// not where a value is not written, or where the motor reported one since its silence, or one
    /// out of range before it.
    pub(super) fn assume(&mut self, ranges: &[RegisterRange; REGISTERS_MAX]) -> bool {
        let ranges = &ranges[..usize::from(self.count)];
        let reported_some = self.next > 0 || self.wrong.is_some();
        if reported_some || ranges.iter().any(|range| range.written.is_none()) {
            return false;
        }
        for (value, range) in self.values.iter_mut().zip(ranges) {
            // A value that was read before a silence is more exact.
            if let Some(written) = range.written.filter(|_| !range.contains(*value)) {
                *value = written;
            }
        }
        self.knowledge = Knowledge::Assumed;
        true
    }

    /// Takes the value of a register. Returns whether it is the last one.
    pub(super) fn take(&mut self, number: u8, value: f32, ranges: &[RegisterRange; REGISTERS_MAX]) -> bool {
        if matches!(self.knowledge, Knowledge::Known) || number != self.next {
            return false;
        }
        if matches!(self.knowledge, Knowledge::Assumed) {
            self.knowledge = Knowledge::Unknown;
        }
        self.values[usize::from(number)] = value;
        if !ranges[usize::from(number)].contains(value) {
            self.wrong = Some(number);
        }
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

    /// Returns whether the values are other ones than those that were reported last, and records
    /// that they are reported.
    pub(super) fn take_change(&mut self) -> bool {
        let bits = |values: [f32; REGISTERS_MAX]| values.map(f32::to_bits);
        self.reported.replace(self.values).map(bits) != Some(bits(self.values))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WRITTEN: [f32; REGISTERS_MAX] = [12.5, 30.0, 10.0];

    fn registers() -> Registers {
        Registers::of(REGISTERS_MAX as u8)
    }

    fn ranges() -> [RegisterRange; REGISTERS_MAX] {
        WRITTEN.map(|end| RegisterRange { least: end - 0.01, most: end + 0.01, written: Some(end) })
    }

    #[test]
    fn assumed_motor_that_answers_must_agree() {
        let (mut registers, ranges) = (registers(), ranges());
        assert!(registers.assume(&ranges) && registers.permits_start());
        assert_eq!(registers.values, WRITTEN);
        assert_eq!(registers.request(Instant::ZERO), Some((0, false)), "it is asked on");
        for (number, value) in [12.5, 50.0, 10.0].into_iter().enumerate() {
            registers.take(number as u8, value, &ranges);
            assert!(!registers.permits_start() && registers.is_unknown(), "not before all are read");
        }
        registers.check(&ranges, Instant::ZERO);
        assert_eq!((registers.wrong, registers.assume(&ranges)), (Some(1), false));
    }

    #[test]
    fn nothing_is_assumed_of_unwritten_or_reported_ends() {
        let (mut one, mut ranges) = (registers(), ranges());
        one.take(0, 12.5, &ranges);
        assert!(!one.assume(&ranges), "it reported one");
        ranges[2].written = None;
        let mut other = registers();
        assert!(!other.assume(&ranges) && !other.permits_start());
    }

    #[test]
    fn contradicted_ends_are_not_assumed_after_silence() {
        let (mut registers, ranges) = (registers(), ranges());
        registers.take(0, 12.5, &ranges);
        registers.take(1, 50.0, &ranges);
        registers.forget();
        assert!(
            !registers.assume(&ranges) && !registers.permits_start(),
            "it reported VMAX 50, and lost the third answer"
        );
        registers.take(0, 12.5, &ranges);
        registers.forget();
        assert!(!registers.assume(&ranges), "VMAX is not read again");
        for (number, value) in WRITTEN.into_iter().enumerate() {
            registers.take(number as u8, value, &ranges);
        }
        registers.check(&ranges, Instant::ZERO);
        registers.forget();
        assert!(registers.assume(&ranges), "all values were in range");
    }
}
