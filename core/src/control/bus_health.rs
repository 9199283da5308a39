//! The health of one bus, as decisions depend on it.

use super::event::{LOSS_TIME, Losses};
use super::motor::Turn;
use motord_bus::Instant;
use motord_shared::{BusCondition, Cause};

/// A bus that refused frames in this many cycles in a row is stalled.
pub(super) const STALL_CYCLES: u32 = 3;

/// The steps of a hold, which the module [`hold`](super::hold) takes.
///
/// ```text
///                no motor answers           each motor         queue emptied,
///                any more                   got one stop       or EMPTY_TIME
///   not held ─────────────────▶ Stopping ───────────────▶ Emptying ─────────▶ Probing
///       ▲                          │                                           ▲  │
///       │                          └───────── a line, which has no queue ──────┘  │
///       └──────────────────── every motor answered its last probe ────────────────┘
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Hold {
    /// Each motor gets one stop: it may receive it even where its replies are lost.
    Stopping,
    /// Nothing is sent until the queue is emptied, or this time.
    Emptying { until: Instant },
    /// The motor with this number on the bus is probed next. The last probe was granted at `last`.
    Probing { last: Instant, turn: usize },
}

#[derive(Debug)]
pub(super) struct BusHealth {
    /// As the bus reports it. A bus that is held is reported as that.
    pub(super) condition: BusCondition,
    /// `None` for a bus that is served.
    pub(super) hold: Option<Hold>,
    /// It carries one request at a time, so nothing waits for it.
    pub(super) is_line: bool,
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
    /// The last question was one for an indicator or a supply, where one was due.
    pub(super) prefers_indicator: bool,
    /// The turn of questions for faults and indicators; only on a line that has one.
    pub(super) question_turn: Option<Turn>,
}

impl BusHealth {
    pub(super) const fn new(joints: Vec<usize>, is_line: bool, question_turn: Option<Turn>) -> Self {
        Self {
            condition: BusCondition::Active,
            hold: None,
            is_line,
            stalled: 0,
            losses: Losses::NONE,
            losses_reported: None,
            joints,
            poll_next: 0,
            poll_at: Instant::ZERO,
            prefers_indicator: false,
            question_turn,
        }
    }

    /// Returns the cause to stop a moving group on this bus, if any.
    pub(super) fn cause(&self) -> Option<Cause> {
        match self.condition {
            BusCondition::Off => Some(Cause::BusOff),
            BusCondition::Down | BusCondition::Gone | BusCondition::Exchanged => Some(Cause::BusGone),
            _ if self.hold.is_some() => Some(Cause::PowerLost),
            _ if self.is_stalled() => Some(Cause::TransmitStall),
            _ => None,
        }
    }

    /// Returns whether frames can be sent and received.
    pub(super) const fn is_up(&self) -> bool {
        matches!(self.condition, BusCondition::Active | BusCondition::Warning | BusCondition::Passive)
    }

    /// Returns whether a probe may show that it serves: it is up, or was down when it was used last.
    pub(super) const fn may_be_probed(&self) -> bool {
        self.is_up() || matches!(self.condition, BusCondition::Down)
    }

    /// Returns the condition for clients and the log.
    pub(super) const fn reported(&self) -> BusCondition {
        if self.hold.is_some() && self.is_up() { BusCondition::Held } else { self.condition }
    }

    /// Returns whether it refused frames in the last [`STALL_CYCLES`].
    pub(super) const fn is_stalled(&self) -> bool {
        self.stalled >= STALL_CYCLES
    }

    /// Returns whether it is up and served.
    pub(super) const fn is_served(&self) -> bool {
        self.is_up() && self.hold.is_none()
    }

    /// Begins to hold it.
    pub(super) const fn begin_hold(&mut self) {
        self.hold = Some(Hold::Stopping);
        self.stalled = 0;
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
