//! The setpoints of a group, kept until newer ones arrive.

use crate::joint::Setpoint;
use motord_bus::{Duration, Instant};

/// A longer distance between two messages is a pause: the mean begins again. The longest setpoint
/// timeout.
const PERIOD_MAX: u64 = 1_000_000_000;

/// The newest setpoints that passed every check, by place in the group.
#[derive(Debug)]
pub(super) struct Setpoints {
    /// When they were sent, or when they arrived if that was earlier. `None`: there are none.
    pub(super) at: Option<Instant>,
    /// The cycle whose states they answer; 0 when their owner names no past cycle.
    pub(super) answered: u64,
    /// The cycle that first used them; 0 before it.
    pub(super) used: u64,
    pub(super) joints: Vec<Setpoint>,
    /// Mean time between two messages of this owner, ns; 0 before the second. The newest distance
    /// weighs 1/8.
    period: u64,
    /// The mean time when their owner was stopped last for sending none.
    pub(super) period_at_stop: Option<Duration>,
}

impl Setpoints {
    /// Creates an empty buffer for a group of `joints` joints. Allocates; nothing after it does.
    pub(super) fn new(joints: usize) -> Self {
        let joints = vec![Setpoint::NEUTRAL; joints];
        Self { at: None, answered: 0, used: 0, joints, period: 0, period_at_stop: None }
    }

    pub(super) fn get(&self, place: usize) -> Option<Setpoint> {
        self.at.and_then(|_| self.joints.get(place)).copied()
    }

    pub(super) fn age(&self, now: Instant) -> Option<Duration> {
        self.at.map(|at| now.since(at))
    }

    /// Records that the newest were sent at `sent`.
    pub(super) fn sent(&mut self, sent: Instant) {
        if let Some(before) = self.at.replace(sent) {
            let distance = sent.as_nanos().saturating_sub(before.as_nanos());
            self.period = match self.period {
                _ if distance > PERIOD_MAX => 0,
                0 => distance,
                period => period - period / 8 + distance / 8,
            };
        }
    }

    /// Returns the mean time between two messages of this owner.
    pub(super) fn period(&self) -> Option<Duration> {
        (self.period > 0).then_some(Duration::from_nanos(self.period))
    }

    pub(super) const fn forget(&mut self) {
        (self.at, self.answered, self.used, self.period) = (None, 0, 0, 0);
    }

    /// Records that the cycle with this number uses them, if there are any.
    pub(super) const fn begin_use(&mut self, cycle: u64) {
        if self.at.is_some() && self.used == 0 {
            self.used = cycle;
        }
    }
}
