//! Messages of the monitor's threads to the drawing thread, and the thread that reads the robot's
//! state.

use super::picture::Reading;
use super::view::Action;
use crate::status::{History, TIMEOUT};
use crossterm::event::KeyEvent;
use motord_client::{Client, Error};
use std::io;
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

/// A message.
#[derive(Debug)]
pub(super) enum Event {
    /// A newer state of the robot.
    Reading(Box<Reading>),
    /// The daemon does not answer.
    Lost(String),
    /// A key.
    Key(KeyEvent),
    /// Text was pasted.
    Pasted,
    /// The terminal has another size.
    Resized,
    /// The outcome of an emergency stop.
    Stop(StopOutcome),
    /// The outcome of another request, by group.
    Done(Action, Vec<(String, Result<(), String>)>),
    /// A thread ended with an error.
    Ended(String),
}

/// The outcome of an emergency stop.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum StopOutcome {
    /// The daemon confirms it, and every motor answers.
    Confirmed,
    /// The daemon confirms it. No state arrived that shows whether each motor answers.
    NotChecked(String),
    /// The daemon confirms it. These joints do not answer.
    MotorsSilent(Vec<String>),
    /// Nothing confirms it.
    NotConfirmed(String),
}

/// Starts a thread. A panic is sent to `events`.
///
/// # Errors
///
/// The thread cannot be started.
pub(super) fn start(
    name: &'static str,
    events: &Sender<Event>,
    body: impl FnOnce(&Sender<Event>) + Send + 'static,
) -> io::Result<()> {
    let report = PanicReport { name, events: events.clone() };
    let run = move || body(&report.events);
    std::thread::Builder::new().name(name.to_owned()).spawn(run)?;
    Ok(())
}

struct PanicReport {
    name: &'static str,
    events: Sender<Event>,
}

impl Drop for PanicReport {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let _receiver_dropped =
                self.events.send(Event::Ended(format!("the thread {} panicked", self.name)));
        }
    }
}

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
