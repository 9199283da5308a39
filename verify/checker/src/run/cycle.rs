//! The record of one cycle from outside. Its frames belong to it, however late they are on the
//! wire.

use super::received::ReceivedCommand;
use crate::state::{Phase, State};
use motord_bus::Instant;
use std::rc::Rc;

/// One cycle.
#[derive(Debug)]
pub(super) struct Cycle {
    /// The state that was published before it.
    pub(super) before: Rc<State>,
    /// The state that it published.
    pub(super) state: Rc<State>,
    pub(super) begun: Instant,
    /// Time since the previous cycle, as far as slews may count it, s.
    pub(super) elapsed: f64,
    /// Sum of all `elapsed`, s.
    pub(super) time: f64,
    /// By group: time of the owner's last message that is good in every respect, or the end of its
    /// horizon.
    pub(super) good_setpoint: Vec<Option<Instant>>,
    /// By group: an enable was requested, and nothing has stopped the group since.
    pub(super) enabled: Vec<bool>,
    /// By motor: its position when a stop could have begun, before and after the cycle's reply,
    /// rad.
    pub(super) held: Vec<[f64; 2]>,
    /// By bus: no fault keeps frames from the wire.
    pub(super) well: Vec<bool>,
    /// By motor: its command in this cycle. A fault request counts as one when the motor received
    /// nothing else.
    pub(super) received: Vec<Option<ReceivedCommand>>,
    /// Number of frames by bus.
    pub(super) frames: Vec<usize>,
}

impl Cycle {
    /// Returns `true` when the group was in this phase before and after the cycle.
    pub(super) fn is(&self, group: usize, phase: Phase) -> bool {
        self.was(group, phase) && self.state.groups[group].phase == phase
    }

    /// Returns `true` when the group was in this phase before the cycle.
    pub(super) fn was(&self, group: usize, phase: Phase) -> bool {
        self.before.groups[group].phase == phase
    }

    /// Returns `true` when the group was in this phase before or after the cycle.
    pub(super) fn touches(&self, group: usize, phase: Phase) -> bool {
        self.was(group, phase) || self.state.groups[group].phase == phase
    }
}
