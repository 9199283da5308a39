//! The health of one bus, as decisions depend on it.

use super::event::{LOSS_TIME, Losses};
use super::motor::Turn;
use motord_bus::Instant;
use motord_shared::{BusCondition, Cause};

/// A bus that refused frames in this many cycles in a row is stalled.
const STALL_CYCLES: u32 = 3;

#[derive(Debug)]
pub(super) struct BusHealth {
    pub(super) condition: BusCondition,
    stalled: u32,
    /// Frames that were lost since the last event of lost frames, and its time.
    losses: Losses,
    losses_reported: Option<Instant>,
    /// Its joints, rising.
    pub(super) joints: Vec<usize>,
    /// Index in `joints` of the next to be asked for its faults.
    pub(super) poll_next: usize,
    /// No motor is due to be asked for its faults before this time.
    pub(super) poll_at: Instant,
    /// The turn of questions for faults and indicators; only on a line that has one.
    pub(super) question_turn: Option<Turn>,
}

impl BusHealth {
    pub(super) const fn new(joints: Vec<usize>, question_turn: Option<Turn>) -> Self {
        Self {
            condition: BusCondition::Active,
            stalled: 0,
            losses: Losses::NONE,
            losses_reported: None,
            joints,
            poll_next: 0,
            poll_at: Instant::ZERO,
            question_turn,
        }
    }

    /// Returns the cause to stop a moving group on this bus, if any.
    pub(super) fn cause(&self) -> Option<Cause> {
        match self.condition {
            BusCondition::Off => Some(Cause::BusOff),
            BusCondition::Down | BusCondition::Gone | BusCondition::Exchanged => Some(Cause::BusGone),
            _ if self.stalled >= STALL_CYCLES => Some(Cause::TransmitStall),
            _ => None,
        }
    }

    /// Returns whether frames can be sent and received.
    pub(super) const fn is_up(&self) -> bool {
        matches!(self.condition, BusCondition::Active | BusCondition::Warning | BusCondition::Passive)
    }

    /// Records lost frames.
    pub(super) const fn lost(&mut self, losses: Losses) {
        self.losses.add(losses);
    }

    /// Returns whether lost frames wait for their event.
    #[inline]
    pub(super) const fn has_losses(&self) -> bool {
        self.losses.any()
    }

    /// Takes the lost frames since the last event, if the next one is due.
    #[cold]
    pub(super) fn due_losses(&mut self, now: Instant) -> Option<Losses> {
        let is_due = self.losses_reported.is_none_or(|reported| now.since(reported) >= LOSS_TIME);
        is_due.then(|| {
            self.losses_reported = Some(now);
            core::mem::take(&mut self.losses)
        })
    }

    /// Records whether the bus accepted all frames of this cycle.
    pub(super) const fn record_acceptance(&mut self, all: bool) {
        self.stalled = if all { 0 } else { self.stalled.saturating_add(1) };
    }
}
