//! The daemon's memory of the groups, beside their states: owners, and who asked for stops.

use motord_client::{Cause, Client, Lease, Phase, State, Telemetry};
use std::time::{Duration, Instant};

/// Telemetry is asked for this often, and when a group has changed.
const PERIOD: Duration = Duration::from_secs(1);

/// The last telemetry, and the groups as they were when it was asked for.
#[derive(Default)]
pub(crate) struct History {
    telemetry: Telemetry,
    asked: Option<(Instant, u64, Vec<GroupKey>)>,
}

/// Lease, phase and cause of a group: when one changes, the telemetry's owner and start cycles of the group are out of date.
type GroupKey = (Option<Lease>, Option<Phase>, Option<Cause>);

impl History {
    /// Telemetry that knows the groups of `state`, at most a second old. Asks the daemon when it must; an older one, or none, when
    /// the daemon does not answer.
    pub(crate) fn telemetry(&mut self, client: &Client, state: &State) -> &Telemetry {
        let boot_id = client.description().boot_id;
        let groups = state.groups().map(|group| (group.lease, group.phase, group.cause)).collect();
        let is_known = |(asked, known_id, known): &(Instant, u64, Vec<GroupKey>)| {
            asked.elapsed() < PERIOD && *known_id == boot_id && *known == groups
        };
        if !self.asked.as_ref().is_some_and(is_known) {
            self.asked = Some((Instant::now(), boot_id, groups));
            // An older one than nothing: a daemon that is busy shows in its states.
            self.telemetry = client.telemetry().unwrap_or_else(|_| std::mem::take(&mut self.telemetry));
        }
        &self.telemetry
    }
}
