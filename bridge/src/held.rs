//! A claimed group: the messages that the bridge sends in each cycle.
//!
//! ```text
//!                  command in force           no command in force
//!  at rest         its setpoints              zero torque, some times a second, which keeps the claim
//!  running         its setpoints              disable, then nothing: motord's own timeout follows
//! ```
//!
//! The end of a run, a disable and a reset end the command: no later enable goes on with its
//! trajectory.

use crate::command::{Command, Target};
use crate::link::GroupLink;
use crate::request::Answer;
use motord_client::{Claim, Error, Phase, Setpoint, State};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Time between two setpoints at rest. The daemon ends a claim after a second without one.
const REST_PERIOD: Duration = Duration::from_millis(100);

/// The message of a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    /// The setpoints of the command.
    Command,
    /// The writer is silent: damp and stop the group.
    Disable,
    /// Zero torque, which the daemon does not follow at rest.
    Rest,
    Nothing,
}

/// Decides by the phase, whether a command is in force, and whether the group was disabled since it
/// ran.
fn step(runs: bool, in_force: bool, is_disabled: bool) -> Step {
    match (runs, in_force) {
        (_, true) => Step::Command,
        (true, false) if is_disabled => Step::Nothing,
        (true, false) => Step::Disable,
        (false, false) => Step::Rest,
    }
}

/// A claimed group.
#[derive(Debug)]
pub(crate) struct Held {
    claim: Claim,
    /// The number under which commands count.
    number: u64,
    command: Option<Command>,
    /// The group ran at the last state.
    ran: bool,
    /// The setpoints of the command were sent, and only need to be repeated.
    is_sent: bool,
    is_disabled: bool,
    rested: Option<Instant>,
    /// The stop that the log has.
    logged: Option<String>,
}

impl Held {
    pub(crate) fn new(claim: Claim, number: u64) -> Self {
        Self {
            claim,
            number,
            command: None,
            ran: false,
            is_sent: false,
            is_disabled: false,
            rested: None,
            logged: None,
        }
    }

    /// Sends what the cycle of `state` needs.
    ///
    /// # Errors
    /// The claim has ended.
    pub(crate) fn serve(&mut self, state: &State, link: &GroupLink, timeout: Duration) -> Result<(), Error> {
        let view = state.of(&self.claim)?;
        let runs = matches!(view.phase(), Some(Phase::Starting | Phase::Active));
        self.is_disabled &= runs;
        if self.ran && !runs {
            self.forget(link);
        }
        self.ran = runs;
        let now = Instant::now();
        self.accept(link);
        let in_force = self.command.as_ref().is_some_and(|command| command.is_in_force(now, timeout));
        match step(runs, in_force, self.is_disabled) {
            Step::Command => self.send(now),
            Step::Disable => self.end_for_silence(link),
            Step::Rest => self.rest(now),
            Step::Nothing => {}
        }
        Ok(())
    }

    /// Takes the newest command, if it counts under this claim.
    fn accept(&mut self, link: &GroupLink) {
        if let Some(command) = link.command.try_take().filter(|command| command.claim == self.number) {
            (self.command, self.is_sent) = (Some(command), false);
        }
    }

    /// Ends the command, also one that was not taken yet.
    fn forget(&mut self, link: &GroupLink) {
        self.command = None;
        drop(link.command.try_take());
    }

    fn send(&mut self, now: Instant) {
        let Some(command) = &self.command else { return };
        let since = now.saturating_duration_since(command.arrived);
        let (horizon, sent) = match &command.target {
            Target::Trajectory(trajectory) => (Duration::ZERO, Err(trajectory.at(since))),
            Target::Setpoints(setpoints) => {
                // A repetition ends at the time of the first message.
                let left = setpoints.horizon.saturating_sub(since);
                (left, if self.is_sent { Ok(()) } else { Err(setpoints.joints.clone()) })
            }
        };
        let claim = &mut self.claim;
        let outcome = claim.set_horizon(horizon).and_then(|()| match &sent {
            Ok(()) => claim.repeat(),
            Err(setpoints) => claim.send(setpoints),
        });
        self.is_sent = true;
        self.log_stop(outcome.err());
    }

    /// The setpoints of a stopped group are sent nevertheless, and keep the claim.
    fn log_stop(&mut self, error: Option<Error>) {
        let stop = error.map(|error| error.to_string());
        if let Some(stop) = stop.as_ref().filter(|stop| self.logged.as_ref() != Some(stop)) {
            log::warn!("{stop}");
        }
        self.logged = stop;
    }

    fn end_for_silence(&mut self, link: &GroupLink) {
        self.command = None;
        self.is_disabled = true;
        link.counters.timeouts.fetch_add(1, Ordering::Relaxed);
        let name = &link.group.name;
        match self.claim.disable() {
            Ok(()) => log::warn!("group {name}: its writer is silent for longer than timeout-ms: disabled"),
            Err(error) => log::error!("group {name}: its writer is silent, and disable failed: {error}"),
        }
    }

    fn rest(&mut self, now: Instant) {
        self.command = None;
        if self.rested.is_some_and(|rested| now.saturating_duration_since(rested) < REST_PERIOD) {
            return;
        }
        self.rested = Some(now);
        let setpoints = vec![Setpoint::torque(0.0); self.claim.joints().len()];
        // The next state tells whether the claim holds.
        let _stopped = self.claim.set_horizon(Duration::ZERO).and_then(|()| self.claim.send(&setpoints));
    }

    /// Starts the group towards the command in force.
    pub(crate) fn enable(&mut self, link: &GroupLink, timeout: Duration) -> Answer {
        let name = &link.group.name;
        self.accept(link);
        let now = Instant::now();
        if !self.command.as_ref().is_some_and(|command| command.is_in_force(now, timeout)) {
            let timeout = timeout.as_secs_f64() * 1e3;
            return Err(format!(
                "no command for group {name} within the last {timeout} ms: send commands first"
            ));
        }
        self.send(now);
        self.claim.enable().map_err(|error| error.to_string())?;
        Ok(format!("group {name} is starting"))
    }

    pub(crate) fn disable(&mut self, link: &GroupLink) -> Result<(), Error> {
        self.forget(link);
        self.claim.disable()
    }

    pub(crate) fn reset(&mut self, link: &GroupLink) -> Result<(), Error> {
        self.forget(link);
        self.claim.reset()
    }

    pub(crate) fn release(self) -> Result<(), Error> {
        self.claim.release()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silent_writer_disables_running_group_once() {
        assert_eq!(step(true, false, false), Step::Disable);
        assert_eq!(step(true, false, true), Step::Nothing);
    }

    #[test]
    fn zero_torque_is_sent_at_rest_only() {
        assert_eq!(step(false, false, false), Step::Rest);
        for is_disabled in [false, true] {
            assert_ne!(step(true, false, is_disabled), Step::Rest);
        }
    }

    #[test]
    fn command_in_force_is_sent_in_any_phase() {
        assert_eq!([true, false].map(|runs| step(runs, true, false)), [Step::Command; 2]);
    }
}
