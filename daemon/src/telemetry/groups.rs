//! The owners of the groups and their last changes, as the events of the cycle tell them.

use super::programs::Programs;
use motord_core::control::Event;
use motord_shared::description::{FirstStop, GroupHistory, Process};

/// Everything that is known of the groups, beside their states.
pub(super) struct Groups(Vec<Group>);

#[derive(Clone, Default)]
struct Group {
    history: GroupHistory,
    /// The latched stop.
    stop: Option<FirstStop>,
}

impl Group {
    /// Takes in a stop. One that replaces another keeps it as the first.
    fn stop(&mut self, stop: FirstStop) {
        let Self { history, stop: latched } = self;
        (history.stop_cycle, history.stopped_by) = (Some(stop.cycle), stop.by.clone());
        let before = latched.replace(stop);
        history.first = history.first.take().or(before);
    }

    fn reset(&mut self) {
        let Self { history, stop } = self;
        (history.stop_cycle, history.stopped_by, history.first, *stop) = (None, None, None, None);
    }
}

impl Groups {
    /// Nothing has happened to any of `count` groups.
    pub(super) fn new(count: usize) -> Self {
        Self(vec![Group::default(); count])
    }

    /// Takes in an event of the cycle `cycle`.
    pub(super) fn record(&mut self, cycle: u64, event: Event, programs: &Programs) {
        let process = |pid| Process { pid, program: programs.program(pid).unwrap_or_default() };
        match event {
            Event::Owner { group, pid: Some(pid) } => {
                self.0[group].history.owner = Some(process(pid));
            }
            Event::Group { group, .. } => self.0[group].history.phase_cycle = cycle,
            Event::Stopped { group, cause, motor, pid } => {
                let program = |pid| programs.of_stop(cause, pid).unwrap_or_default();
                let by = pid.map(|pid| Process { pid, program: program(pid) });
                self.0[group].stop(FirstStop { cause: cause.code(), joint: motor, cycle, by });
            }
            Event::Reset { group } => self.0[group].reset(),
            _ => {}
        }
    }

    /// In the order of the configuration.
    pub(super) fn history(&self) -> Vec<GroupHistory> {
        self.0.iter().map(|group| group.history.clone()).collect()
    }
}

/// Each level lasts for at least 2 s, so no line is left out.
pub(super) fn log_supply(cycle: u64, group: &str, (motor, voltage): (&str, f32), is_low: bool) {
    if is_low {
        tracing::warn!(
            cycle,
            group,
            motor,
            see = "supply-warning",
            "most motors report a supply below `supply-warn-v`, this one {voltage:.1} V: charge or replace the battery"
        );
    } else {
        tracing::info!(cycle, group, motor, "the supply is above `supply-warn-v` again: {voltage:.1} V");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_shared::{Cause, Phase};

    #[test]
    fn last_owner_is_kept_and_reset_clears_stop() {
        let mut groups = Groups::new(2);
        let (pid, programs) = (std::process::id(), Programs::default());
        groups.record(5, Event::Owner { group: 1, pid: Some(pid) }, &programs);
        groups.record(6, Event::Owner { group: 1, pid: None }, &programs);
        groups.record(
            7,
            Event::Stopped { group: 1, cause: Cause::OwnerLost, motor: None, pid: Some(pid) },
            &programs,
        );
        groups.record(7, Event::Group { group: 1, phase: Phase::Damping }, &programs);
        let history = &groups.history()[1];
        assert_eq!(history.owner.as_ref().map(|owner| owner.pid), Some(pid));
        assert_eq!((history.phase_cycle, history.stop_cycle), (7, Some(7)));
        assert_eq!(history.stopped_by.as_ref().map(|process| process.pid), Some(pid));
        groups.record(9, Event::Reset { group: 1 }, &programs);
        let history = &groups.history()[1];
        assert_eq!((history.stop_cycle, &history.stopped_by), (None, &None));
        assert_eq!(groups.history()[0], GroupHistory::default());
    }

    #[test]
    fn first_stop_is_kept_beside_emergency_stop() {
        let (mut groups, programs) = (Groups::new(1), Programs::default());
        let lost = Event::Stopped { group: 0, cause: Cause::MotorLost, motor: Some(3), pid: None };
        groups.record(7, lost, &programs);
        assert_eq!(groups.history()[0].first, None);
        for cycle in [8, 9] {
            let stop = Event::Stopped { group: 0, cause: Cause::EmergencyStop, motor: None, pid: Some(1) };
            groups.record(cycle, stop, &programs);
        }
        let first = FirstStop { cause: Cause::MotorLost.code(), joint: Some(3), cycle: 7, by: None };
        assert_eq!(groups.history()[0].first, Some(first));
        groups.record(10, Event::Reset { group: 0 }, &programs);
        assert_eq!(groups.history()[0].first, None);
    }
}
