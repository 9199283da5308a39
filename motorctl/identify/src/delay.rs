//! The time that a motor needs to answer, from the stamps of commands and answers.

use crate::interval::{Value, Why};
use crate::sample::Sample;

/// Bits of the shortest frame of 8 bytes by those of the longest, with stuff bits and the space
/// between frames: 108 of 135.
const SHORTEST_SHARE: f64 = 0.8;
/// Largest half of the distance of bounds that bound anything, s.
const WIDEST: f64 = 50e-6;

/// The wire between the computer and the motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BusTiming {
    /// The longest time of a frame, s.
    pub frame: f64,
    /// Other motors on the bus.
    pub others: usize,
    /// Its frames are those of CAN. On a serial line nothing bounds the answer from below.
    pub is_can: bool,
}

/// Times from a command to its answer, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Delay {
    /// Shortest, median and longest time from the sending of a command to the receipt of its
    /// answer.
    pub answers: [f64; 3],
    /// From the end of a command to the begin of its answer: `reply-latency-us`. Includes what
    /// computer and adapter add.
    pub motor: Value,
    /// From the sending of a command until its torque acts. Lower end: its frame. Upper end: its
    /// answer was under way.
    pub action: [f64; 2],
}

impl Delay {
    /// Returns the bounds from the stamps; `None` without samples.
    pub(crate) fn of(samples: &[Sample], wire: BusTiming) -> Option<Self> {
        let mut times: Vec<f64> =
            samples.iter().map(|sample| sample.latency).filter(|time| *time > 0.0).collect();
        times.sort_by(f64::total_cmp);
        let (shortest, longest) = (*times.first()?, *times.last()?);
        let least = if wire.is_can { SHORTEST_SHARE * wire.frame } else { 0.0 };
        let most = 2.0 * wire.frame * (1.0 + wire.others as f64);
        let upper = (shortest - 2.0 * least).max(0.0);
        let lower = if wire.is_can { (shortest - most).max(0.0) } else { 0.0 };
        let why = ((upper - lower) / 2.0 > WIDEST).then_some(Why::Stamps);
        Some(Self {
            answers: [shortest, times[times.len() / 2], longest],
            motor: Value { value: (lower + upper) / 2.0, lower, upper, why },
            action: [least, shortest - least],
        })
    }
}
