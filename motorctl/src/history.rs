//! Telemetry of the groups: owners, and the processes that requested stops.

use motord_client::{Cause, Client, Lease, Phase, State, Telemetry};
use std::time::{Duration, Instant};

/// Time between two requests of telemetry while no group changes.
const PERIOD: Duration = Duration::from_secs(1);

/// The last telemetry, and the groups at the time of its request.
#[derive(Default)]
pub(crate) struct History {
    telemetry: Telemetry,
    asked: Option<(Instant, u64, Vec<GroupKey>)>,
}

/// Lease, phase and cause of a group. A change makes the telemetry of the group obsolete.
type GroupKey = (Option<Lease>, Option<Phase>, Option<Cause>);

impl History {
    /// Returns telemetry that matches the groups of `state` and is at most a second old. If the
    /// daemon does not answer, it is older or empty.
    pub(crate) fn telemetry(&mut self, client: &Client, state: &State) -> &Telemetry {
        let boot_id = client.description().boot_id;
        let groups = state.groups().map(|group| (group.lease, group.phase, group.cause)).collect();
        let is_known = |(asked, known_id, known): &(Instant, u64, Vec<GroupKey>)| {
            asked.elapsed() < PERIOD && *known_id == boot_id && *known == groups
        };
        if !self.asked.as_ref().is_some_and(is_known) {
            self.asked = Some((Instant::now(), boot_id, groups));
            // Old telemetry is better than none.
            self.telemetry = client.telemetry().unwrap_or_else(|_| std::mem::take(&mut self.telemetry));
        }
        &self.telemetry
    }
}
