//! The record of one cycle as seen from outside. Its frames are judged by it, however late they leave.

use super::heard::Heard;
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
    /// Since the cycle before, as far as slews may count it, s.
    pub(super) elapsed: f64,
    /// The sum of all `elapsed`, s.
    pub(super) time: f64,
    /// By group: when the owner last sent a message that is good in every respect.
    pub(super) good_setpoint: Vec<Option<Instant>>,
    /// By group: an enable was asked for, and nothing has stopped the group since.
    pub(super) enabled: Vec<bool>,
    /// By motor: where it stood when a stop could have begun, before and after the cycle's reply, rad.
    pub(super) held: Vec<[f64; 2]>,
    /// By bus: nothing keeps frames from the wire.
    pub(super) well: Vec<bool>,
    /// By motor: its command in this cycle. A question for faults counts as one when the motor heard nothing else.
    pub(super) heard: Vec<Option<Heard>>,
    /// Frames by bus.
    pub(super) frames: Vec<usize>,
}

impl Cycle {
    /// The group was in this phase before the cycle, and after it.
    pub(super) fn is(&self, group: usize, phase: Phase) -> bool {
        self.was(group, phase) && self.state.groups[group].phase == phase
    }

    /// The group was in this phase before the cycle.
    pub(super) fn was(&self, group: usize, phase: Phase) -> bool {
        self.before.groups[group].phase == phase
    }

    /// The group was in this phase before the cycle, or after it.
    pub(super) fn touches(&self, group: usize, phase: Phase) -> bool {
        self.was(group, phase) || self.state.groups[group].phase == phase
    }
}
