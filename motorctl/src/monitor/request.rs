//! The requests of the user, and their outcomes.
//!
//! An emergency stop has a separate thread: it waits neither for other requests nor for the screen.

use super::events::{self, Event, StopOutcome};
use super::question::Question;
use super::view::Action;
use crate::confirmation;
use motord_client::{Client, Error};
use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Sender, SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// Longest wait for the confirmation of a stop before an alarm. The daemon answers within two
/// cycles.
const CONFIRMED_MAX: Duration = Duration::from_millis(300);

/// How long the outcome of a request is shown.
const SHOWN: Duration = Duration::from_secs(10);

/// The threads that send requests.
#[derive(Debug, Clone)]
pub(super) struct Requests {
    stop: SyncSender<()>,
    others: SyncSender<(Action, Vec<String>)>,
}

impl Requests {
    /// Starts the threads. A failed emergency stop is sent again to `instance` over a new
    /// connection.
    ///
    /// # Errors
    ///
    /// A thread cannot be started.
    pub(super) fn start(
        client: &Arc<Client>,
        instance: Option<&str>,
        events: &Sender<Event>,
    ) -> io::Result<Self> {
        let (stop, stops) = sync_channel(1);
        let (others, requests) = sync_channel::<(Action, Vec<String>)>(1);
        let (stopping, asking) = (Arc::clone(client), Arc::clone(client));
        let instance = instance.map(str::to_owned);
        events::start("motorctl-stop", events, move |events| {
            for () in stops {
                let _left = events.send(Event::Stop(stop_robot(&stopping, instance.as_deref())));
            }
        })?;
        events::start("motorctl-ask", events, move |events| {
            for (action, groups) in requests {
                let outcome = groups.into_iter().map(|group| {
                    let outcome = ask(&asking, action, &group).map_err(|error| error.to_string());
                    (group, outcome)
                });
                let _left = events.send(Event::Done(action, outcome.collect()));
            }
        })?;
        Ok(Self { stop, others })
    }

    /// Requests the emergency stop. One more may wait behind the present one; further ones are
    /// dropped.
    pub(super) fn stop(&self) {
        let _already_pending = self.stop.try_send(());
    }

    /// Requests `action` on `groups`. Returns false if a request already waits behind the present
    /// one.
    pub(super) fn ask(&self, action: Action, groups: Vec<String>) -> bool {
        self.others.try_send((action, groups)).is_ok()
    }
}

/// Stops the robot over the daemon's socket or the open connection. After a failure it opens a new
/// connection.
fn stop_robot(client: &Client, instance: Option<&str>) -> StopOutcome {
    let outcome = |stopped: Result<(), Error>| match stopped {
        Ok(()) => StopOutcome::Confirmed,
        Err(Error::MotorsOffline { joints }) => StopOutcome::MotorsSilent(joints),
        Err(Error::MotorsUnchecked { reason }) => StopOutcome::NotChecked(reason.to_string()),
        Err(error) => StopOutcome::NotConfirmed(error.to_string()),
    };
    match (outcome(client.emergency_stop()), instance) {
        (StopOutcome::NotConfirmed(_), Some(instance)) => outcome(motord_client::emergency_stop(instance)),
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

/// The urgency of a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Tone {
    /// A success.
    Plain,
    /// A failure.
    Warning,
    /// The robot may move although a stop was requested.
    Alarm,
}

/// The progress of an emergency stop requested here.
#[derive(Debug, Clone, Default)]
enum StopProgress {
    #[default]
    None,
    Asked(Instant),
    Done(Instant, StopOutcome),
}

impl StopProgress {
    /// Returns whether it is known that every motor is stopped.
    fn is_sure(&self) -> bool {
        matches!(self, Self::Done(_, StopOutcome::Confirmed))
    }
}

/// The question and the outcomes that are shown. Outcomes stand for ten seconds, except that of a
/// stop that is not confirmed.
#[derive(Debug, Clone, Default)]
pub(super) struct Notice {
    stop: StopProgress,
    message: Option<(Instant, Tone, String)>,
    /// The open question.
    pub(super) question: Option<Question>,
    /// The progress of the program that opened the monitor.
    pub(super) progress: Option<String>,
}

impl Notice {
    /// Clears the outcomes after a key. An unconfirmed stop stays.
    pub(super) fn forget(&mut self) {
        self.message = None;
        if self.stop.is_sure() {
            self.stop = StopProgress::None;
        }
    }

    /// Clears the question and all outcomes: another daemon runs, to which they do not apply.
    pub(super) fn forget_daemon(&mut self) {
        *self = Self { progress: self.progress.take(), ..Self::default() };
    }

    /// Records that an emergency stop was requested.
    pub(super) fn stop_asked(&mut self) {
        if !matches!(self.stop, StopProgress::Asked(_)) {
            self.stop = StopProgress::Asked(Instant::now());
        }
    }

    /// Records the outcome of the emergency stop.
    pub(super) fn stop_done(&mut self, outcome: StopOutcome) {
        self.stop = StopProgress::Done(Instant::now(), outcome);
    }

    /// Records the outcome of another request.
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
        self.show(if is_good { Tone::Plain } else { Tone::Warning }, &texts.join("; "));
    }

    /// Shows `text` for ten seconds, or until the next key.
    pub(super) fn show(&mut self, tone: Tone, text: &str) {
        self.message = Some((Instant::now(), tone, text.to_owned()));
    }

    /// Returns the lines to show at `now`.
    pub(super) fn texts(&self, now: Instant) -> Vec<(Tone, String)> {
        let is_shown = |since: &Instant| now.saturating_duration_since(*since) < SHOWN;
        let question = self.question.as_ref().map(|question| (Tone::Warning, question.text.clone()));
        let message = self.message.as_ref().filter(|(since, ..)| is_shown(since));
        let message = message.map(|(_, tone, text)| (*tone, text.clone()));
        let progress = self.progress.clone().map(|progress| (Tone::Plain, progress));
        self.stop_text(now).into_iter().chain(message).chain(question).chain(progress).collect()
    }

    fn stop_text(&self, now: Instant) -> Option<(Tone, String)> {
        let is_over = |since: &Instant, limit| now.saturating_duration_since(*since) >= limit;
        match &self.stop {
            StopProgress::None => None,
            StopProgress::Asked(since) if is_over(since, CONFIRMED_MAX) => {
                Some((Tone::Alarm, "EMERGENCY STOP NOT CONFIRMED yet: cut the power".to_owned()))
            }
            StopProgress::Asked(_) => Some((Tone::Warning, "emergency stop: requested".to_owned())),
            StopProgress::Done(since, StopOutcome::Confirmed) if is_over(since, SHOWN) => None,
            StopProgress::Done(_, outcome) => Some(done_text(outcome)),
        }
    }
}

fn done_text(outcome: &StopOutcome) -> (Tone, String) {
    const CONFIRMED: &str = "emergency stop confirmed: every motor is being damped, then stopped";
    match outcome {
        StopOutcome::Confirmed => (Tone::Plain, CONFIRMED.to_owned()),
        StopOutcome::NotChecked(error) => (Tone::Warning, confirmation::not_checked(CONFIRMED, error)),
        StopOutcome::MotorsSilent(joints) => (
            Tone::Alarm,
            format!("EMERGENCY STOP confirmed, {}", confirmation::motors_silent(&joints.join(", "))),
        ),
        StopOutcome::NotConfirmed(error) => {
            (Tone::Alarm, format!("EMERGENCY STOP NOT CONFIRMED: cut the power. {error}"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unconfirmed_stop_stays_on_screen() {
        let mut notice = Notice::default();
        notice.stop_asked();
        notice.stop_done(StopOutcome::NotConfirmed("no motord runs".to_owned()));
        notice.forget();
        let alarm = "EMERGENCY STOP NOT CONFIRMED: cut the power. no motord runs";
        assert_eq!(notice.texts(Instant::now()), [(Tone::Alarm, alarm.to_owned())]);
        notice.stop_asked();
        notice.stop_done(StopOutcome::Confirmed);
        assert_eq!(notice.texts(Instant::now())[0].0, Tone::Plain);
        notice.forget();
        assert_eq!(notice.texts(Instant::now()), []);
    }

    #[test]
    fn outcome_expires_and_unconfirmed_stop_stays() {
        let mut notice = Notice::default();
        notice.done(Action::Disable, &[("legs".to_owned(), Ok(()))]);
        notice.stop_done(StopOutcome::Confirmed);
        let now = Instant::now();
        assert_eq!(notice.texts(now).len(), 2);
        assert_eq!(notice.texts(now + SHOWN), []);
        notice.stop_done(StopOutcome::NotConfirmed("no motord runs".to_owned()));
        assert_eq!(notice.texts(now + 200 * SHOWN).len(), 1);
        notice.forget_daemon();
        assert_eq!(notice.texts(now), []);
    }

    #[test]
    fn unheard_stop_is_an_alarm() {
        let mut notice = Notice::default();
        notice.stop_done(StopOutcome::MotorsSilent(vec!["rr-hip".to_owned(), "rr-knee".to_owned()]));
        notice.forget();
        let [(Tone::Alarm, text)] = &notice.texts(Instant::now() + SHOWN)[..] else { panic!("no alarm") };
        assert!(text.contains("cut the power") && text.contains("rr-hip, rr-knee"), "{text}");
    }

    #[test]
    fn stop_without_answer_is_soon_an_alarm() {
        let long_ago = Instant::now().checked_sub(2 * CONFIRMED_MAX).unwrap();
        let notice = Notice { stop: StopProgress::Asked(long_ago), ..Notice::default() };
        assert_eq!(notice.texts(Instant::now())[0].0, Tone::Alarm);
    }

    #[test]
    fn refusal_by_one_group_is_shown_beside_others() {
        let mut notice = Notice::default();
        let outcomes = [("legs".to_owned(), Ok(())), ("arm".to_owned(), Err("refused".to_owned()))];
        notice.done(Action::Reset, &outcomes);
        assert_eq!(notice.texts(Instant::now()), [(Tone::Warning, "legs: reset; arm: refused".to_owned())]);
    }
}
