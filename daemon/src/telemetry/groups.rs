//! The owners of the groups and their last changes, as the events of the cycle tell them.

use super::askers::Askers;
use motord_core::control::Event;
use motord_shared::description::{GroupHistory, Process};

/// Everything that is known of the groups, beside their states.
pub(super) struct Groups(Vec<GroupHistory>);

impl Groups {
    /// Nothing has happened to any of `count` groups.
    pub(super) fn new(count: usize) -> Self {
        Self(vec![GroupHistory::default(); count])
    }

    /// Takes in an event of the cycle `cycle`.
    pub(super) fn record(&mut self, cycle: u64, event: Event, askers: &Askers) {
        let process = |pid| Process { pid, program: askers.program(pid).unwrap_or_default() };
        match event {
            Event::Owner { group, pid: Some(pid) } => {
                self.0[group].owner = Some(process(pid));
            }
            Event::Group { group, .. } => self.0[group].phase_cycle = cycle,
            Event::Stopped { group, pid, .. } => {
                let group = &mut self.0[group];
                (group.stop_cycle, group.stopped_by) = (Some(cycle), pid.map(process));
            }
            Event::Reset { group } => {
                let group = &mut self.0[group];
                (group.stop_cycle, group.stopped_by) = (None, None);
            }
            _ => {}
        }
    }

    /// In the order of the configuration.
    pub(super) fn history(&self) -> Vec<GroupHistory> {
        self.0.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_shared::{Cause, Phase};

    #[test]
    fn last_owner_is_kept_and_reset_clears_stop() {
        let mut groups = Groups::new(2);
        let (pid, askers) = (std::process::id(), Askers::default());
        groups.record(5, Event::Owner { group: 1, pid: Some(pid) }, &askers);
        groups.record(6, Event::Owner { group: 1, pid: None }, &askers);
        groups.record(
            7,
            Event::Stopped { group: 1, cause: Cause::OwnerLost, motor: None, pid: Some(pid) },
            &askers,
        );
        groups.record(7, Event::Group { group: 1, phase: Phase::Damping }, &askers);
        let history = &groups.history()[1];
        assert_eq!(history.owner.as_ref().map(|owner| owner.pid), Some(pid));
        assert_eq!((history.phase_cycle, history.stop_cycle), (7, Some(7)));
        assert_eq!(history.stopped_by.as_ref().map(|process| process.pid), Some(pid));
        groups.record(9, Event::Reset { group: 1 }, &askers);
        let history = &groups.history()[1];
        assert_eq!((history.stop_cycle, &history.stopped_by), (None, &None));
        assert_eq!(groups.history()[0], GroupHistory::default());
    }
}
