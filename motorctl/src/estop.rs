//! `motorctl estop`: damps and stops every motor of a daemon, or of all.

use crate::advice::motorctl;
use crate::confirmation;
use crate::failure::Failure;
use crate::instances::{foreign, line, listener_of};
use crate::outcome::print_effect;
use crate::report::FirstStopReport;
use crate::status::{self, TIMEOUT};
use motord_client::{AllStopped, emergency_stop, emergency_stop_all, emergency_stop_in, running_instances};
use motord_client::{Client, DEFAULT_INSTANCE, Error, GroupHistory, RunningInstance, StopError, Telemetry};
use motord_terminal::printable;
use nix::sys::resource::{Resource, getrlimit, setrlimit};
use std::io::{self, Write};
use std::time::{Duration, Instant};

/// Time between two requests for the history of the stops.
const TURN: Duration = Duration::from_millis(10);

/// Stops `instance`, or `all` daemons.
///
/// # Errors
///
/// A stop is not confirmed, or motors do not answer.
pub(crate) fn run(instance: &str, all: bool) -> Result<(), Failure> {
    if all {
        return stop_all();
    }
    match confirmed(emergency_stop(instance)) {
        Ok(()) => report_stop(None, &motorctl(instance), status::connect(instance)),
        // The motors of a daemon that died may still move: the stop of another one is no success.
        Err(error @ Error::NotRunning { died: None, .. }) => {
            elsewhere(instance).map_or(Err(Failure::NotStopped(error)), |only| stop(&only))
        }
        Err(error) => Err(Failure::NotStopped(error)),
    }
}

/// Returns success for each confirmed stop: [`report_stop`] names the motors that do not answer.
fn confirmed(stopped: Result<(), Error>) -> Result<(), Error> {
    match stopped {
        Err(Error::MotorsOffline { .. } | Error::MotorsUnchecked { .. }) => Ok(()),
        stopped => stopped,
    }
}

/// Returns the only daemon that `instance` can mean, in another runtime directory. The default name
/// means any. A process of another user is never meant: any user may take the name of a daemon, and
/// confirm.
fn elsewhere(instance: &str) -> Option<RunningInstance> {
    let mut meant: Vec<_> = running_instances();
    meant.retain(|running| instance == DEFAULT_INSTANCE || running.name == instance);
    if meant.len() == 1 { meant.pop() } else { None }
}

/// Stops every daemon of this computer, all at once. The motors of each are checked after all
/// stops.
fn stop_all() -> Result<(), Failure> {
    raise_descriptors();
    let AllStopped { daemons, foreign: reached, unreached } = emergency_stop_all();
    let (mut unconfirmed, mut silent, mut full) = (Vec::new(), Vec::new(), Vec::new());
    for (other, error) in unreached {
        match error {
            // It may be a daemon of this user: nothing is known.
            StopError::System(_) => unconfirmed.push(format!("{}: {error}", listener_of(&other))),
            _ => full.push(other),
        }
    }
    let others = foreign("estop", &reached, &full);
    if daemons.is_empty() && unconfirmed.is_empty() {
        return Err(Failure::NothingToStop(others));
    }
    for (running, outcome) in daemons {
        match outcome.map_err(Failure::NotStopped).and_then(|()| report_stop_of(&running)) {
            Ok(()) => {}
            Err(Failure::MotorsSilent(motors)) => silent.push(motors),
            // The alarm is printed once, before all of them.
            Err(Failure::NotStopped(error)) => unconfirmed.push(format!("{}: {error}", running.name)),
            Err(failure) => unconfirmed.push(format!("{}: {failure}", running.name)),
        }
    }
    match (unconfirmed.is_empty(), silent.is_empty()) {
        (true, true) => {
            if !others.is_empty() {
                let _unread = writeln!(io::stderr(), "motorctl: {}", printable(&others));
            }
            Ok(())
        }
        (true, false) => Err(Failure::MotorsSilent(silent.join(", "))),
        (false, _) => {
            let silent = silent.into_iter().map(|motors| Failure::MotorsSilent(motors).to_string());
            let others = Some(others).filter(|others| !others.is_empty());
            Err(Failure::NotAllStopped(unconfirmed.into_iter().chain(silent).chain(others).collect()))
        }
    }
}

/// Raises the limit of open files as far as permitted. With too few, the stop of all still tries
/// one name after the other.
fn raise_descriptors() {
    let Ok((_, hard)) = getrlimit(Resource::RLIMIT_NOFILE) else { return };
    let _refused = setrlimit(Resource::RLIMIT_NOFILE, hard, hard);
}

fn stop(running: &RunningInstance) -> Result<(), Failure> {
    confirmed(emergency_stop_in(&running.runtime, &running.name)).map_err(Failure::NotStopped)?;
    report_stop_of(running)
}

/// Prints the outcome of the confirmed stop of `running`.
fn report_stop_of(running: &RunningInstance) -> Result<(), Failure> {
    let RunningInstance { name, runtime, pid, uid } = running;
    let who = format!("instance {name} in {} (process {pid}, user id {uid})", runtime.display());
    report_stop(Some(&who), &line(running), Client::connect_in(runtime, name))
}

/// Prints the outcome of a confirmed stop; `motorctl` is the command for its daemon. The motors are
/// checked only now: no wait may delay the stop.
fn report_stop(who: Option<&str>, motorctl: &str, client: Result<Client, Error>) -> Result<(), Failure> {
    let client = match client {
        // Any user may take the name of the socket in a directory of their own, and confirm.
        Err(error @ Error::NotRunning { .. }) if who.is_some() => return Err(Failure::NotStopped(error)),
        client => client,
    };
    let of = who.map(|who| format!(" of {who}")).unwrap_or_default();
    let silent = client.as_ref().map_err(Error::to_string);
    let silent =
        silent.and_then(|client| client.offline_joints(None, TIMEOUT).map_err(|error| error.to_string()));
    let first = client.as_ref().map(first_causes).unwrap_or_default();
    let done = format!(
        "confirmed: every motor{of} is being damped, then stopped; `{motorctl} reset` clears the emergency stop{first}"
    );
    let outcome = confirmation::outcome(&done, silent);
    print_effect(
        &outcome.map_err(|silent| Failure::MotorsSilent(format!("{}{of}{first}", silent.join(", "))))?,
    );
    Ok(())
}

/// Returns what had stopped groups before, as a further part of a sentence; empty if nothing had.
/// The emergency stop replaces their causes, and a person needs them to find the fault. Takes at
/// most [`TIMEOUT`] and one request.
fn first_causes(client: &Client) -> String {
    let robot = client.description();
    let end = Instant::now() + TIMEOUT;
    let groups = loop {
        let Ok(Telemetry { groups, .. }) = client.telemetry() else { return String::new() };
        // The daemon writes its history some milliseconds after the stop.
        let is_ours = |group: &GroupHistory| {
            group.first.is_some()
                || group.stopped_by.as_ref().is_some_and(|process| process.pid == std::process::id())
        };
        if groups.iter().all(is_ours) || Instant::now() >= end {
            break groups;
        }
        std::thread::sleep(TURN);
    };
    let first = robot.groups.iter().zip(&groups).filter_map(|(group, history)| {
        let first = FirstStopReport::new(history.first.as_ref()?, &robot);
        Some(format!("; {} had been stopped for {} before: {}", group.name, first.cause, first.describe()))
    });
    first.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Any user may take the name of a socket for emergency stops in a directory of their own, and
    /// confirm.
    #[test]
    fn confirmation_of_no_daemon_is_none() {
        let directory = tempfile::tempdir().unwrap();
        let client = Client::connect_in(directory.path(), DEFAULT_INSTANCE);
        let outcome = report_stop(Some("instance robot"), "motorctl", client);
        assert!(matches!(outcome, Err(Failure::NotStopped(Error::NotRunning { .. }))), "{outcome:?}");
    }
}
