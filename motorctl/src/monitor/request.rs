//! The requests of the user, and their outcomes.
//!
//! An emergency stop has a separate thread: it waits neither for other requests nor for the screen.

use super::events::{self, Event, StopOutcome};
use super::view::Action;
use crate::confirmation;
use crate::report::RobotReport;
use crossterm::event::{KeyCode, KeyEvent};
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

/// A `y` that follows sooner is no answer of a person who has read the question: a terminal without
/// bracketed paste passes pasted text as keys.
const READ_MIN: Duration = Duration::from_millis(500);

/// A question, until the next key.
#[derive(Debug, Clone)]
pub(super) struct Question {
    asked_at: Instant,
    /// The stopped groups whose causes would be cleared.
    pub(super) groups: Vec<String>,
    /// The question, with the causes and who asked for the stops.
    pub(super) text: String,
}

impl Question {
    /// Returns the question for those of the chosen groups that are stopped by a cause; `None` when
    /// there is none.
    pub(super) fn about(robot: &RobotReport, chosen: &[String], now: Instant) -> Option<Self> {
        let stopped = robot.groups.iter().filter(|group| chosen.contains(&group.name));
        let stops: Vec<_> = stopped.filter_map(|group| Some((group, group.stop.as_ref()?))).collect();
        let mut reasons: Vec<String> = Vec::new();
        for (_, stop) in &stops {
            let reason = stop.reason();
            if !reasons.contains(&reason) {
                reasons.push(reason);
            }
        }
        let groups: Vec<String> = stops.iter().map(|(group, _)| group.name.clone()).collect();
        let (names, reasons) = (groups.join(", "), reasons.join(" "));
        let text =
            format!("Clear the stop of {names}? {reasons} Press y to clear it, another key to keep it.");
        (!groups.is_empty()).then_some(Self { asked_at: now, groups, text })
    }

    /// Returns whether `key` at `now` answers yes.
    pub(super) fn is_agreed(&self, key: &KeyEvent, now: Instant) -> bool {
        key.code == KeyCode::Char('y') && now.saturating_duration_since(self.asked_at) >= READ_MIN
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{GroupReport, ProcessReport, StopReport};

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

    fn robot() -> RobotReport {
        let stop = StopReport {
            sentence: "An emergency stop was requested.",
            asked_by: Some(ProcessReport { pid: 42, program: Some("motorctl".to_owned()) }),
            ..StopReport::default()
        };
        let group = |name: &str, stop| GroupReport { name: name.to_owned(), stop, ..GroupReport::default() };
        let groups = vec![group("legs", Some(stop.clone())), group("arm", None), group("tail", Some(stop))];
        RobotReport { groups, ..RobotReport::default() }
    }

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn question_names_groups_cause_and_who_stopped() {
        let question = Question::about(&robot(), &names(&["legs", "arm", "tail"]), Instant::now()).unwrap();
        assert_eq!(question.groups, names(&["legs", "tail"]));
        assert_eq!(
            question.text,
            "Clear the stop of legs, tail? An emergency stop was requested. (by pid 42, motorctl) Press y to clear it, \
             another key to keep it."
        );
        assert!(Question::about(&robot(), &names(&["arm"]), Instant::now()).is_none());
    }

    #[test]
    fn only_late_y_agrees() {
        let now = Instant::now();
        let question = Question::about(&robot(), &names(&["legs"]), now).unwrap();
        let key = |letter| KeyEvent::from(KeyCode::Char(letter));
        assert!(!question.is_agreed(&key('y'), now + READ_MIN / 2), "pasted text");
        assert!(!question.is_agreed(&key('r'), now + 2 * READ_MIN));
        assert!(question.is_agreed(&key('y'), now + READ_MIN));
    }
}
