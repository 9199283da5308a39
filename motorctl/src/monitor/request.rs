//! The requests of the person in front of the screen, and their outcomes.
//!
//! An emergency stop has a thread of its own: it waits for no other request, and not for the screen.

use super::news::{self, News};
use super::view::Action;
use motord_client::{Client, Error};
use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Sender, SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// A stop that is not confirmed by now is an alarm. The daemon answers within a cycle or two.
const CONFIRMED_MAX: Duration = Duration::from_millis(300);

/// The threads that ask the daemon.
#[derive(Debug, Clone)]
pub(super) struct Requests {
    stop: SyncSender<()>,
    others: SyncSender<(Action, Vec<String>)>,
}

impl Requests {
    /// Starts them. `instance` is where an emergency stop tries once more with a connection of its own.
    ///
    /// # Errors
    ///
    /// When there are no threads to be had.
    pub(super) fn start(
        client: &Arc<Client>,
        instance: Option<&str>,
        news: &Sender<News>,
    ) -> io::Result<Self> {
        let (stop, stops) = sync_channel(1);
        let (others, requests) = sync_channel::<(Action, Vec<String>)>(1);
        let (stopping, asking) = (Arc::clone(client), Arc::clone(client));
        let instance = instance.map(str::to_owned);
        news::start("motorctl-stop", news, move |news| {
            for () in stops {
                let outcome = stop_robot(&stopping, instance.as_deref());
                let _left = news.send(News::Stop(outcome.map_err(|error| error.to_string())));
            }
        })?;
        news::start("motorctl-ask", news, move |news| {
            for (action, groups) in requests {
                let outcome = groups.into_iter().map(|group| {
                    let outcome = ask(&asking, action, &group).map_err(|error| error.to_string());
                    (group, outcome)
                });
                let _left = news.send(News::Done(action, outcome.collect()));
            }
        })?;
        Ok(Self { stop, others })
    }

    /// Asks for the emergency stop. One more may wait behind the one under way; further ones are dropped.
    pub(super) fn stop(&self) {
        let _under_way = self.stop.try_send(());
    }

    /// Asks for `action` on `groups`. Returns whether it was taken: one request may wait behind the one under way.
    pub(super) fn ask(&self, action: Action, groups: Vec<String>) -> bool {
        self.others.try_send((action, groups)).is_ok()
    }
}

/// Stops the robot over the daemon's socket or the open connection. After a failure it tries again with a new connection.
fn stop_robot(client: &Client, instance: Option<&str>) -> Result<(), Error> {
    let first = client.emergency_stop();
    match (first, instance) {
        (Err(_), Some(instance)) => motord_client::emergency_stop(instance),
        (first, _) => first,
    }
}

fn ask(client: &Client, action: Action, group: &str) -> Result<(), Error> {
    match action {
        Action::Disable => client.disable(group),
        Action::Reset => client.reset(group),
        Action::Quit => Ok(()),
    }
}

/// How urgent a text is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Tone {
    /// Something that went as asked.
    Plain,
    /// Something that did not.
    Warning,
    /// The robot may move although it was to stop.
    Alarm,
}

/// An emergency stop that was asked for here.
#[derive(Debug, Clone, Default)]
enum StopProgress {
    #[default]
    None,
    Asked(Instant),
    Confirmed,
    NotConfirmed(String),
}

/// The outcomes that are shown.
#[derive(Debug, Clone, Default)]
pub(super) struct Notice {
    stop: StopProgress,
    said: Option<(Tone, String)>,
    /// How far the program is that shows this monitor.
    pub(super) progress: Option<String>,
}

impl Notice {
    /// A key was pressed: what was said has been read. A stop that is not confirmed stays.
    pub(super) fn forget(&mut self) {
        self.said = None;
        if matches!(self.stop, StopProgress::Confirmed) {
            self.stop = StopProgress::None;
        }
    }

    /// An emergency stop is under way.
    pub(super) fn stop_asked(&mut self) {
        if !matches!(self.stop, StopProgress::Asked(_)) {
            self.stop = StopProgress::Asked(Instant::now());
        }
    }

    /// The outcome of the emergency stop.
    pub(super) fn stop_done(&mut self, outcome: Result<(), String>) {
        self.stop = outcome.map_or_else(StopProgress::NotConfirmed, |()| StopProgress::Confirmed);
    }

    /// The outcome of another request.
    pub(super) fn done(&mut self, action: Action, outcomes: &[(String, Result<(), String>)]) {
        let done = if action == Action::Disable { "stopped, after damping what moves" } else { "reset" };
        let texts: Vec<String> = outcomes
            .iter()
            .map(|(group, outcome)| match outcome {
                Ok(()) => format!("{group}: {done}"),
                Err(error) => format!("{group}: {error}"),
            })
            .collect();
        let is_good = outcomes.iter().all(|(_, outcome)| outcome.is_ok());
        self.said = Some((if is_good { Tone::Plain } else { Tone::Warning }, texts.join("; ")));
    }

    /// Another request is still under way.
    pub(super) fn busy(&mut self) {
        self.said = Some((Tone::Warning, "the last request is still under way".to_owned()));
    }

    /// The lines to show.
    pub(super) fn texts(&self) -> Vec<(Tone, String)> {
        let stop = match &self.stop {
            StopProgress::None => None,
            StopProgress::Asked(since) if since.elapsed() < CONFIRMED_MAX => {
                Some((Tone::Warning, "emergency stop: asked for".to_owned()))
            }
            StopProgress::Asked(_) => {
                Some((Tone::Alarm, "EMERGENCY STOP NOT CONFIRMED yet: cut the power".to_owned()))
            }
            StopProgress::Confirmed => Some((
                Tone::Plain,
                "emergency stop confirmed: every motor is being damped, then stopped".to_owned(),
            )),
            StopProgress::NotConfirmed(error) => {
                Some((Tone::Alarm, format!("EMERGENCY STOP NOT CONFIRMED: cut the power. {error}")))
            }
        };
        let progress = self.progress.clone().map(|progress| (Tone::Plain, progress));
        stop.into_iter().chain(self.said.clone()).chain(progress).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unconfirmed_stop_stays_on_screen() {
        let mut notice = Notice::default();
        notice.stop_asked();
        notice.stop_done(Err("no motord runs".to_owned()));
        notice.forget();
        let alarm = "EMERGENCY STOP NOT CONFIRMED: cut the power. no motord runs";
        assert_eq!(notice.texts(), [(Tone::Alarm, alarm.to_owned())]);
        notice.stop_asked();
        notice.stop_done(Ok(()));
        assert_eq!(notice.texts()[0].0, Tone::Plain);
        notice.forget();
        assert_eq!(notice.texts(), []);
    }

    #[test]
    fn stop_without_answer_is_soon_an_alarm() {
        let long_ago = Instant::now().checked_sub(2 * CONFIRMED_MAX).unwrap();
        let notice = Notice { stop: StopProgress::Asked(long_ago), ..Notice::default() };
        assert_eq!(notice.texts()[0].0, Tone::Alarm);
    }

    #[test]
    fn refusal_by_one_group_is_shown_beside_others() {
        let mut notice = Notice::default();
        let outcomes = [("legs".to_owned(), Ok(())), ("arm".to_owned(), Err("refused".to_owned()))];
        notice.done(Action::Reset, &outcomes);
        assert_eq!(notice.texts(), [(Tone::Warning, "legs: reset; arm: refused".to_owned())]);
    }
}
