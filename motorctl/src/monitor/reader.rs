//! The thread that reads the robot's state, also across restarts of the daemon.

use super::news::News;
use super::picture::Reading;
use crate::status::PATIENCE;
use motord_client::{Cause, Client, Error, Lease, Phase, State, Telemetry};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

/// Telemetry is asked for this often, and when a group has changed.
const TELEMETRY_PERIOD: Duration = Duration::from_secs(1);

/// Reads the newest state once in each `period`, until nobody listens.
pub(super) fn read(client: &Client, period: Duration, news: &Sender<News>) {
    let mut memory = Memory::default();
    let mut next = Instant::now();
    loop {
        let outcome = match client.wait(PATIENCE) {
            Ok(state) => Some(News::Reading(Box::new(memory.reading(client, &state)))),
            // Slower than the patience, but not overdue.
            Err(Error::Timeout { .. }) => None,
            Err(error) => Some(News::Lost(error.to_string())),
        };
        if outcome.is_some_and(|outcome| news.send(outcome).is_err()) {
            return;
        }
        next = (next + period).max(Instant::now());
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
}

/// The last telemetry, and the groups as they were when it was asked for.
#[derive(Default)]
struct Memory {
    telemetry: Telemetry,
    asked: Option<(Instant, u64, Vec<GroupKey>)>,
}

/// Telemetry tells the owner and the beginnings of these.
type GroupKey = (Option<Lease>, Option<Phase>, Option<Cause>);

impl Memory {
    fn reading(&mut self, client: &Client, state: &State) -> Reading {
        let robot = client.description();
        let groups = state.groups().map(|group| (group.lease, group.phase, group.cause)).collect();
        let is_known = |(asked, boot_id, known): &(Instant, u64, Vec<GroupKey>)| {
            asked.elapsed() < TELEMETRY_PERIOD && *boot_id == robot.boot_id && *known == groups
        };
        if !self.asked.as_ref().is_some_and(is_known) {
            self.asked = Some((Instant::now(), robot.boot_id, groups));
            // An older one than nothing: a daemon that is busy shows in its states.
            self.telemetry = client.telemetry().unwrap_or_else(|_| std::mem::take(&mut self.telemetry));
        }
        Reading::new(&robot, state, &self.telemetry)
    }
}
