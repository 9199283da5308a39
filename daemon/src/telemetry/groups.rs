//! The owners of the groups and their last changes, as the events of the cycle tell them.

use crate::host::process;
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
    pub(super) fn record(&mut self, cycle: u64, event: Event) {
        match event {
            Event::Owner { group, pid: Some(pid) } => {
                // It is asked for now: after the owner's end nobody can tell.
                let program = process::program(pid).unwrap_or_default();
                self.0[group].owner = Some(Process { pid, program });
            }
            Event::Group { group, .. } => self.0[group].phase_cycle = cycle,
            Event::Stopped { group, .. } => self.0[group].stop_cycle = Some(cycle),
            Event::Reset { group } => self.0[group].stop_cycle = None,
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
    fn the_last_owner_is_remembered_and_a_reset_forgets_the_stop() {
        let mut groups = Groups::new(2);
        let pid = std::process::id();
        groups.record(5, Event::Owner { group: 1, pid: Some(pid) });
        groups.record(6, Event::Owner { group: 1, pid: None });
        groups.record(7, Event::Stopped { group: 1, cause: Cause::OwnerLost, motor: None });
        groups.record(7, Event::Group { group: 1, phase: Phase::Damping });
        let history = &groups.history()[1];
        assert_eq!(history.owner.as_ref().map(|owner| owner.pid), Some(pid));
        assert_eq!((history.phase_cycle, history.stop_cycle), (7, Some(7)));
        groups.record(9, Event::Reset { group: 1 });
        assert_eq!(groups.history()[1].stop_cycle, None);
        assert_eq!(groups.history()[0], GroupHistory::default());
    }
}
