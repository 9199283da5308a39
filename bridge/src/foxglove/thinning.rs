//! The choice of topics that are due for a state.

use crate::config::Foxglove;
use crate::pace::Pace;
use motord_client::StateMessage;
use motord_mcap::Topic;

/// Cycles between two states where no topic needs any: for events.
const IDLE_CYCLES: u32 = 100;

/// Phase, cause and lease of a group.
type Mark = (u32, u32, u64);

/// The paces of the topics, and what is known of the groups.
#[derive(Debug)]
pub(crate) struct Thinning {
    joints: Pace,
    imus: Pace,
    groups: Pace,
    buses: Pace,
    marks: Vec<Mark>,
}

/// The kinds of topics that are due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Due {
    pub(crate) joints: bool,
    imus: bool,
    groups: bool,
    buses: bool,
}

impl Thinning {
    /// Creates the paces for a daemon with `cycle_hz` cycles per second.
    pub(crate) fn new(settings: &Foxglove, cycle_hz: f64) -> Self {
        let pace = |hz| Pace::new(hz, cycle_hz);
        Self {
            joints: pace(settings.joints_hz),
            imus: pace(settings.imus_hz),
            groups: pace(settings.groups_hz),
            buses: pace(settings.buses_hz),
            marks: Vec::new(),
        }
    }

    /// Returns the number of cycles after which the fastest topic needs a state.
    pub(crate) fn cycles_between_states(&self) -> u32 {
        let paces = [self.joints, self.imus, self.groups, self.buses];
        let fastest = paces.iter().map(|pace| pace.cycles).filter(|cycles| *cycles > 0).min();
        fastest.and_then(|cycles| u32::try_from(cycles).ok()).unwrap_or(IDLE_CYCLES)
    }

    /// Returns what is due for `state`. A group that changed is due out of turn.
    pub(crate) fn due(&mut self, state: &StateMessage) -> Due {
        let marks = state.groups().iter().map(|group| (group.phase, group.cause, group.lease)).collect();
        let has_changed = std::mem::replace(&mut self.marks, marks) != self.marks;
        let cycle = state.cycle;
        let groups = self.groups.is_due(cycle);
        Due {
            joints: self.joints.is_due(cycle),
            imus: self.imus.is_due(cycle),
            groups: groups || (has_changed && self.groups.cycles > 0),
            buses: self.buses.is_due(cycle),
        }
    }
}

impl Due {
    /// Returns `true` if the topic is due. Events have no pace.
    pub(crate) fn contains(self, topic: Topic) -> bool {
        match topic {
            Topic::Joint(_) => self.joints,
            Topic::Imu(_) => self.imus,
            Topic::Group(_) | Topic::Cycle => self.groups,
            Topic::Bus(_) | Topic::Indicators(_) => self.buses,
            Topic::Events => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(joints_hz: f64, groups_hz: f64) -> Foxglove {
        Foxglove { joints_hz, imus_hz: 0.0, groups_hz, buses_hz: 0.0, ..Foxglove::default() }
    }

    #[test]
    fn rates_hold_whichever_states_arrive() {
        let mut thinning = Thinning::new(&settings(50.0, 10.0), 1000.0);
        assert_eq!(thinning.cycles_between_states(), 20);
        let (mut joints, mut groups) = (0, 0);
        for cycle in (0..10_000).step_by(7) {
            let due = thinning.due(&StateMessage { cycle, ..StateMessage::default() });
            joints += u32::from(due.contains(Topic::Joint(0)));
            groups += u32::from(due.contains(Topic::Group(0)));
            assert!(!due.contains(Topic::Imu(0)) && !due.contains(Topic::Bus(0)));
        }
        assert_eq!((joints, groups), (500, 100));
    }

    #[test]
    fn stopped_group_is_due_out_of_turn() {
        let mut thinning = Thinning::new(&settings(0.0, 1.0), 1000.0);
        let mut state = StateMessage { cycle: 1, group_count: 1, ..StateMessage::default() };
        assert!(thinning.due(&state).groups);
        state.cycle = 2;
        assert!(!thinning.due(&state).groups);
        state.groups[0].cause = 1;
        assert!(thinning.due(&state).groups);
        assert!(!thinning.due(&state).groups);
    }

    #[test]
    fn rates_of_zero_leave_states_for_events() {
        let mut thinning = Thinning::new(&settings(0.0, 0.0), 1000.0);
        assert_eq!(thinning.cycles_between_states(), IDLE_CYCLES);
        let due = thinning.due(&StateMessage { cycle: 1, group_count: 1, ..StateMessage::default() });
        assert_eq!(due, Due { joints: false, imus: false, groups: false, buses: false });
    }
}
