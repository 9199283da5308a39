//! The one connection of a process, shared by its [`Client`](crate::Client) and its claims.

use crate::Error;
use crate::state::State;
use motord_shared::description::RobotDescription;
use motord_shared::instance::{Attachment, process_exists};
use motord_shared::limits::JOINTS_MAX;
use motord_shared::message::AdminReply;
use motord_shared::ports::{ClientPorts, SetpointPort};
use motord_shared::service::ServiceError;
use motord_shared::{AdminRequest, Instance, Lease, Operation};
use serde::de::DeserializeOwned;
use std::rc::Rc;
use std::time::{Duration, Instant};

/// How long an answer may take. The daemon answers within a cycle or two; a machine that stalls gets some more.
pub(crate) const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);

/// How often a request looks for its answer: well below a cycle.
const ANSWER_POLL: Duration = Duration::from_micros(200);

/// Shortest time without a state after which the daemon counts as silent, in cycles and as a time.
const SILENCE_CYCLES: f64 = 5.0;
const SILENCE_MIN: Duration = Duration::from_millis(50);

/// Longest sleep on the cycle event: it bounds what a lost wake-up costs.
const SLEEP_MAX: Duration = Duration::from_secs(1);

/// What is asked about.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Subject {
    pub(crate) lease: Option<Lease>,
    pub(crate) group: usize,
    pub(crate) joint: usize,
}

/// The ports, what the daemon said of itself, and its newest state.
#[derive(Debug)]
pub(crate) struct Link {
    instance: Instance,
    ports: ClientPorts,
    /// Who is there, as the daemon of `boot_id` said.
    pub(crate) robot: Rc<RobotDescription>,
    /// Changes exactly when another daemon's states arrive.
    pub(crate) boot_id: u64,
    /// Longest time without a state that is no error.
    pub(crate) silence: Duration,
    newest: Option<State>,
    unseen: bool,
    heard: Option<Instant>,
    silence_told: bool,
}

impl Link {
    /// `open` takes the ports.
    pub(crate) fn open(
        instance: Instance,
        open: fn(Attachment) -> Result<ClientPorts, ServiceError>,
    ) -> Result<Self, Error> {
        let attachment = instance.attach().map_err(Error::of_instance)?;
        let attachment = attachment.ok_or_else(|| Error::not_running(&instance))?;
        let ports = open(attachment).map_err(|error| Error::of_service(error, &instance))?;
        let mut link = Self {
            instance,
            ports,
            robot: Rc::default(),
            boot_id: 0,
            silence: SILENCE_MIN,
            newest: None,
            unseen: false,
            heard: None,
            silence_told: false,
        };
        link.read_description()?;
        link.boot_id = link.robot.boot_id;
        Ok(link)
    }

    /// Takes in what has arrived. When it comes from another daemon, its description is read first, which may take up to
    /// [`ANSWER_TIMEOUT`].
    pub(crate) fn poll(&mut self) -> Result<(), Error> {
        let arrived = self.ports.newest_state().map_err(|error| Error::of_service(error, &self.instance))?;
        self.heard.get_or_insert_with(Instant::now);
        let Some(state) = arrived.map(State::from) else { return Ok(()) };
        if state.boot_id() != self.boot_id {
            self.read_description()?;
            self.boot_id = state.boot_id();
        }
        self.newest = Some(state);
        self.unseen = true;
        self.heard = Some(Instant::now());
        self.silence_told = false;
        Ok(())
    }

    /// The newest state, if nobody took it yet.
    pub(crate) fn take_unseen(&mut self) -> Option<State> {
        self.newest.filter(|_| std::mem::take(&mut self.unseen))
    }

    pub(crate) fn sleep_until_cycle(&mut self, at_most: Duration) -> Result<(), Error> {
        let slept = self.ports.sleep_until_cycle(at_most.min(SLEEP_MAX));
        slept.map_err(|error| Error::of_service(error, &self.instance))
    }

    /// How long a caller that has waited for `waited` of `timeout` may go on. A silence is told as soon as it lasts too
    /// long; a caller that tries again in spite of it waits for its full time.
    pub(crate) fn patience(&mut self, waited: Duration, timeout: Duration) -> Result<Duration, Error> {
        let left = timeout.saturating_sub(waited);
        let until_silence = self.silence.saturating_sub(self.quiet());
        if until_silence.is_zero() && (left.is_zero() || !self.silence_told) {
            self.silence_told = true;
            return Err(self.gone());
        }
        if left.is_zero() {
            return Err(Error::Timeout { waited });
        }
        Ok(if self.silence_told { left } else { left.min(until_silence) })
    }

    /// The newest state, taken or not.
    pub(crate) fn newest(&self) -> Option<&State> {
        self.newest.as_ref()
    }

    /// That states have stopped, if they have.
    pub(crate) fn check_alive(&self) -> Result<(), Error> {
        if self.quiet() >= self.silence { Err(self.gone()) } else { Ok(()) }
    }

    fn quiet(&self) -> Duration {
        self.heard.map_or(Duration::ZERO, |heard| heard.elapsed())
    }

    fn gone(&self) -> Error {
        if process_exists(self.robot.pid) {
            Error::Silent { silent_for: self.quiet() }
        } else {
            Error::not_running(&self.instance)
        }
    }

    /// Asks, and waits for the answer at most `timeout`.
    pub(crate) fn ask(
        &self,
        operation: Operation,
        subject: Subject,
        timeout: Duration,
    ) -> Result<(AdminReply, Vec<u8>), Error> {
        self.ask_while(operation, subject, timeout, || Ok(()))
    }

    /// Asks, and does `meanwhile` again and again until the answer is there.
    pub(crate) fn ask_while(
        &self,
        operation: Operation,
        subject: Subject,
        timeout: Duration,
        mut meanwhile: impl FnMut() -> Result<(), Error>,
    ) -> Result<(AdminReply, Vec<u8>), Error> {
        let index = |index: usize| u32::try_from(index).unwrap_or(u32::MAX);
        let request = AdminRequest {
            lease: subject.lease.map_or(0, Lease::raw),
            operation: operation.code(),
            group: index(subject.group),
            joint: index(subject.joint),
            pid: std::process::id(),
        };
        let question = self.ports.ask(request).map_err(|error| Error::of_service(error, &self.instance))?;
        let begun = Instant::now();
        loop {
            meanwhile()?;
            let answer = question.answer().map_err(|error| Error::of_service(error, &self.instance))?;
            match answer {
                Some((reply, text)) if reply.refusal == 0 => return Ok((reply, text)),
                Some((reply, _)) => {
                    return Err(Error::refused(operation, reply.refusal, reply.detail, &self.robot));
                }
                None if begun.elapsed() < timeout => std::thread::sleep(ANSWER_POLL),
                None if self.robot.pid != 0 && !process_exists(self.robot.pid) => {
                    return Err(Error::not_running(&self.instance));
                }
                None => return Err(Error::NoAnswer { operation, waited: timeout }),
            }
        }
    }

    /// Asks for something that is answered with JSON.
    pub(crate) fn read<T: DeserializeOwned>(&self, operation: Operation) -> Result<T, Error> {
        let (_, text) = self.ask(operation, Subject::default(), ANSWER_TIMEOUT)?;
        serde_json::from_slice(&text).map_err(|_| Error::NotUnderstood { operation })
    }

    pub(crate) fn setpoint_port(&self) -> Result<SetpointPort, Error> {
        self.ports.setpoint_port().map_err(|error| Error::of_service(error, &self.instance))
    }

    /// For errors of a port that was taken from this link.
    pub(crate) fn instance(&self) -> &Instance {
        &self.instance
    }

    fn read_description(&mut self) -> Result<(), Error> {
        let robot: RobotDescription = self.read(Operation::Describe)?;
        let sound = |index: &usize| *index < robot.joints.len();
        if robot.joints.len() > JOINTS_MAX || !robot.groups.iter().flat_map(|group| &group.joints).all(sound)
        {
            return Err(Error::NotUnderstood { operation: Operation::Describe });
        }
        let cycles = Duration::try_from_secs_f64(SILENCE_CYCLES / robot.rate_hz).unwrap_or(SILENCE_MIN);
        self.silence = self.silence.max(cycles);
        self.robot = Rc::new(robot);
        Ok(())
    }
}
