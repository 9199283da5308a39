//! The emergency stop, over all available paths.
//!
//! First through the daemon's socket, whose resources other processes cannot exhaust; then through
//! the services. A confirmed stop is no success while motors do not answer.

use crate::link::{ANSWER_TIMEOUT, Connection};
use crate::{Error, RobotDescription};
use motord_ports::running::{self, AllStops, RunningInstance};
use motord_ports::stop_socket::{AskedStop, StopError};
use motord_ports::stop_source::StopSource;
use motord_ports::{ClientPorts, Instance, clock, liveness};
use motord_shared::message::ALL_GROUPS;
use motord_shared::{AdminRequest, Operation};
use std::path::Path;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread::ScopedJoinHandle;
use std::time::{Duration, Instant};

/// Time after which the second path is also tried. A healthy daemon confirms within a cycle or two.
pub(crate) const SOCKET_TIMEOUT: Duration = Duration::from_millis(100);
/// Interval at which the paths are checked for an answer.
const POLL: Duration = Duration::from_millis(1);

/// Damps and stops every motor of `instance`, over a separate connection: first through the socket
/// of the daemon, which needs no file and no slot, then through the services. Then checks that each
/// motor answers. Usually takes some cycles, 0.3 s longer while motors do not answer, and at most
/// little more than two seconds.
///
/// # Errors
/// Motors may still move, so cut the power. The stop is unconfirmed: [`Error::NotRunning`],
/// [`Error::Permission`], [`Error::NotStopped`], and those of an invalid name or directory. Or it
/// is confirmed, and motors may not have received it: [`Error::MotorsOffline`] names them,
/// [`Error::MotorsUnchecked`] has the reason why that is not known.
pub fn emergency_stop(instance: &str) -> Result<(), Error> {
    emergency_stop_for(instance, "")
}

/// As [`emergency_stop`]. The log of the daemon and the history of the groups show `source`, such as
/// a person or a button, behind the process: at most 128 bytes.
///
/// # Errors
/// Those of [`emergency_stop`].
pub fn emergency_stop_for(instance: &str, source: &str) -> Result<(), Error> {
    let instance = Instance::find(instance).map_err(Error::of_instance)?;
    stop_and_check(&instance, &StopSource::new(source))
}

/// Damps and stops every motor of `instance` in the runtime directory `runtime`, as
/// [`emergency_stop`] does.
///
/// # Errors
/// Those of [`emergency_stop`].
pub fn emergency_stop_in(runtime: &Path, instance: &str) -> Result<(), Error> {
    let instance = Instance::below(runtime, instance).map_err(Error::of_instance)?;
    stop_and_check(&instance, &StopSource::NONE)
}

/// Damps and stops every motor of `instance` for `source`, and checks that each one answers, over
/// connections of its own.
pub(crate) fn stop_and_check(instance: &Instance, source: &StopSource) -> Result<(), Error> {
    stop(instance, source)?;
    // As below: damaged files may block a thread.
    let (answer, checked) = channel();
    let other = instance.clone();
    let _refused = std::thread::Builder::new().spawn(move || {
        let link = Connection::open(other, ClientPorts::open_to_stop).map_err(unchecked);
        answer.send(link.and_then(|link| link.check_answers()))
    });
    let late = Error::NoAnswer { operation: Operation::Describe, waited: ANSWER_TIMEOUT };
    checked.recv_timeout(ANSWER_TIMEOUT).unwrap_or_else(|_| Err(unchecked(late)))
}

/// The outcome of [`emergency_stop_all`].
#[derive(Debug)]
pub struct AllStopped {
    /// The daemons of this user, of root and of the service, with the error if the stop of one is
    /// unconfirmed.
    pub daemons: Vec<(RunningInstance, Result<(), Error>)>,
    /// Processes of other users to which the request was sent. They may be daemons. Their answers
    /// do not count, and nothing in their directories was opened.
    pub foreign: Vec<RunningInstance>,
    /// Other processes that did not get the request, or whose directories were not checked in time,
    /// with the reason. Only with [`StopError::System`] one may be a daemon of this user, of root
    /// or of the service.
    pub unreached: Vec<(RunningInstance, StopError)>,
}

/// Damps and stops every motor of every daemon of this computer, all at once. Usually takes a cycle
/// or two, at most little more than a second, however many daemons do not answer. Whether the
/// motors answer is not checked.
#[must_use]
pub fn emergency_stop_all() -> AllStopped {
    let AllStops { trusted, foreign, unreached } = running::stop_all(SOCKET_TIMEOUT);
    let again = |running: &RunningInstance| {
        let instance = Instance::below(&running.runtime, &running.name).map_err(Error::of_instance)?;
        stop(&instance, &StopSource::NONE)
    };
    let outcomes: Vec<_> = std::thread::scope(|threads| {
        let stopping: Vec<_> = trusted
            .iter()
            .map(|(running, outcome)| match outcome {
                Ok(()) => Stopping::Confirmed,
                Err(_) => std::thread::Builder::new()
                    .spawn_scoped(threads, move || again(running))
                    .map_or(Stopping::WithoutThread, Stopping::InThread),
            })
            .collect();
        let panicked = |_| Err(Error::NotStopped { socket: StopError::NoReply, services: None });
        let outcome = |(stopping, (running, _)): (_, &(RunningInstance, _))| match stopping {
            Stopping::Confirmed => Ok(()),
            Stopping::InThread(stop) => stop.join().unwrap_or_else(panicked),
            Stopping::WithoutThread => again(running),
        };
        stopping.into_iter().zip(&trusted).map(outcome).collect()
    });
    let daemons = trusted.into_iter().map(|(running, _)| running).zip(outcomes).collect();
    AllStopped { daemons, foreign, unreached }
}

/// The stop of a daemon by both ways.
enum Stopping<'scope> {
    /// The first way sufficed.
    Confirmed,
    InThread(ScopedJoinHandle<'scope, Result<(), Error>>),
    /// The limit of threads is reached: one after the other.
    WithoutThread,
}

/// Damps and stops every motor of `instance`. Whether the motors answer is not checked.
fn stop(instance: &Instance, source: &StopSource) -> Result<(), Error> {
    let mut first = SocketStop::send(instance, source);
    if first.is_confirmed(SOCKET_TIMEOUT) {
        return Ok(());
    }
    // Access to damaged files may block a thread for longer than a person can wait.
    let (answer, second) = channel();
    let (other, end) = (instance.clone(), Instant::now() + ANSWER_TIMEOUT);
    let _refused = std::thread::Builder::new().spawn(move || answer.send(through_services(&other, end)));
    let mut refused = None;
    while Instant::now() < end && !(first.is_over() && refused.is_some()) {
        match second.recv_timeout(POLL) {
            Ok(Ok(())) => return Ok(()),
            Ok(Err(error)) => refused = Some(error),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => std::thread::sleep(POLL),
        }
        if first.is_confirmed(Duration::ZERO) {
            return Ok(());
        }
    }
    Err(first.reason(refused, instance))
}

/// A stop request through the socket.
#[derive(Debug)]
pub(crate) struct SocketStop {
    /// `None` once no further answer is expected.
    asked: Option<AskedStop>,
    error: StopError,
}

impl SocketStop {
    /// Sends the request for `source`. Waits at most [`SOCKET_TIMEOUT`] while the daemon has too many
    /// callers.
    pub(crate) fn send(instance: &Instance, source: &StopSource) -> Self {
        match AskedStop::send_for(instance, source, SOCKET_TIMEOUT) {
            Ok(asked) => Self { asked: Some(asked), error: StopError::NoReply },
            Err(error) => Self { asked: None, error },
        }
    }

    /// Returns `true` if the daemon confirms within the usual time.
    pub(crate) fn is_confirmed_soon(&mut self) -> bool {
        self.is_confirmed(SOCKET_TIMEOUT)
    }

    /// Returns `true` if the daemon has confirmed. Waits at most `timeout` plus a millisecond.
    pub(crate) fn is_confirmed(&mut self, timeout: Duration) -> bool {
        let Some(asked) = &self.asked else { return false };
        match asked.confirm(timeout) {
            Ok(()) => return true,
            Err(StopError::NoReply) => {}
            Err(error) => (self.asked, self.error) = (None, error),
        }
        false
    }

    /// Returns `true` once no further answer is expected.
    fn is_over(&self) -> bool {
        self.asked.is_none()
    }

    /// Returns the reason why the stop is unconfirmed; `second` is the error of the services.
    pub(crate) fn reason(self, second: Option<Error>, instance: &Instance) -> Error {
        match (self.error, second) {
            (StopError::NotRunning, Some(error @ (Error::NotRunning { .. } | Error::Permission { .. }))) => {
                error
            }
            (StopError::NotPermitted, _) => Error::Permission { path: instance.runtime().to_owned() },
            (socket, services) => Error::NotStopped { socket, services: services.map(Box::new) },
        }
    }
}

/// Sends the request through the services, over a slot reserved for emergency stops. Reads nothing
/// before.
fn through_services(instance: &Instance, end: Instant) -> Result<(), Error> {
    let of_service = |error| Error::of_service(error, instance);
    // The files of a daemon that died stay, and answer nothing.
    if liveness::is_dead(instance) {
        return Err(Error::not_running(instance));
    }
    let attachment = instance.attach().map_err(Error::of_instance)?;
    let attachment = attachment.ok_or_else(|| Error::not_running(instance))?;
    let ports = ClientPorts::open_to_stop(attachment).map_err(of_service)?;
    let operation = Operation::EmergencyStop;
    let (pid, asked) = (std::process::id(), Instant::now());
    let request = AdminRequest { operation: operation.code(), group: ALL_GROUPS, pid, ..Default::default() };
    let question = ports.ask(request).map_err(of_service)?;
    while Instant::now() < end {
        match question.answer().map_err(of_service)? {
            Some((reply, _)) if reply.refusal == 0 => return Ok(()),
            Some((reply, _)) => {
                let robot = RobotDescription::default();
                return Err(Error::refused(operation, reply.refusal, reply.detail, &robot));
            }
            None => std::thread::sleep(POLL),
        }
    }
    Err(Error::NoAnswer { operation, waited: asked.elapsed() })
}

/// Time in which each motor must answer after a confirmed stop, and the same in cycles: lost
/// replies must not look like a lost motor.
const ANSWERS_MIN: Duration = Duration::from_millis(300);
const ANSWERS_CYCLES: u32 = 5;

/// Returns the error of a confirmed stop after which the answers of the motors are not known.
pub(crate) fn unchecked(reason: Error) -> Error {
    Error::MotorsUnchecked { reason: Box::new(reason) }
}

impl Connection {
    /// Opens the ports that [`check_answers`](Self::check_answers) needs, if descriptors are free: a
    /// stop without the check is better than none.
    pub(crate) fn prepare_check(&self) {
        let _later = self.poll();
        let _later = self.sleep(None, Duration::ZERO);
    }

    /// Checks that each motor answers, after a confirmed stop.
    ///
    /// # Errors
    /// [`Error::MotorsOffline`], [`Error::MotorsUnchecked`].
    pub(crate) fn check_answers(&self) -> Result<(), Error> {
        let most = ANSWERS_MIN.max(self.robot().period().saturating_mul(ANSWERS_CYCLES));
        let joints = self.offline_joints(None, most).map_err(unchecked)?;
        if joints.is_empty() { Ok(()) } else { Err(Error::MotorsOffline { joints }) }
    }

    /// Returns the joints of the group with this index, or of all groups, whose motors do not
    /// answer after this call, within `timeout`, without excluded joints. Returns as soon as all
    /// have answered. Takes no state from a thread that waits for one.
    ///
    /// # Errors
    /// [`Error::NotRunning`], [`Error::Silent`] and [`Error::Timeout`] when no state arrives.
    pub(crate) fn offline_joints(
        &self,
        group: Option<usize>,
        timeout: Duration,
    ) -> Result<Vec<String>, Error> {
        let (begun, asked_ns) = (Instant::now(), clock::now_ns());
        let mut offline = None;
        loop {
            let seen = self.published();
            offline = self.offline_since(asked_ns, group)?.or(offline);
            let left = timeout.saturating_sub(begun.elapsed());
            match offline {
                Some(joints) if joints.is_empty() || left.is_zero() => return Ok(joints),
                None if left.is_zero() => {
                    self.check_alive()?;
                    return Err(Error::Timeout { waited: timeout });
                }
                _ => self.sleep(seen, left)?,
            }
        }
    }

    /// Returns the joints whose motors have not answered after `asked_ns`, by the newest state;
    /// `None` for a state of before.
    fn offline_since(&self, asked_ns: u64, group: Option<usize>) -> Result<Option<Vec<String>>, Error> {
        let view = self.poll()?;
        let Some(state) = view.newest.as_ref().filter(|state| state.publish_ns() > asked_ns) else {
            return Ok(None);
        };
        let robot = self.robot();
        let members = group.and_then(|group| robot.groups.get(group)).map(|group| &group.joints);
        let has_answered = |index| {
            state.joint(index).is_some_and(|joint| joint.is_excluded() || joint.receive_ns > asked_ns)
        };
        let offline = robot.joints.iter().enumerate().filter(|(index, _)| {
            members.is_none_or(|members| members.contains(index)) && !has_answered(*index)
        });
        Ok(Some(offline.map(|(_, joint)| joint.name.clone()).collect()))
    }
}
