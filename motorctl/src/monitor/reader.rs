//! The thread that reads the robot's state, also across restarts of the daemon.

use super::events::Event;
use super::picture::Reading;
use crate::history::History;
use crate::status::TIMEOUT;
use motord_client::{Client, Error};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

/// Reads the newest state once per `period`, until the drawing thread ends.
pub(super) fn read(client: &Client, period: Duration, events: &Sender<Event>) {
    let mut history = History::default();
    let mut next = Instant::now();
    loop {
        let outcome = match client.wait(TIMEOUT) {
            Ok(state) => {
                let telemetry = history.telemetry(client, &state);
                Some(Event::Reading(Box::new(Reading::new(&client.description(), &state, telemetry))))
            }
            // No state arrived, but the last one is too young to count as silence.
            Err(Error::Timeout { .. }) => None,
            Err(error) => Some(Event::Lost(error.to_string())),
        };
        if outcome.is_some_and(|outcome| events.send(outcome).is_err()) {
            return;
        }
        next = (next + period).max(Instant::now());
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
}
