//! The question before the cause of a stop is cleared.

use crate::report::RobotReport;
use crossterm::event::{KeyCode, KeyEvent};
use std::time::{Duration, Instant};

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
