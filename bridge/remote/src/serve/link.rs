//! The ports of the daemon, opened again after its death.

use motord_ports::{ClientPorts, Instance, Question, ServiceError, SetpointPort, clock};
use motord_shared::limits::GROUPS_MAX;
use motord_shared::message::AdminReply;
use motord_shared::{AdminRequest, Lease, SetpointMessage};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Longest time for the daemon's answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);
/// Interval of the checks for an answer.
const ANSWER_POLL: Duration = Duration::from_micros(200);

/// The reason why the daemon cannot be reached.
#[derive(Debug, thiserror::Error)]
pub(super) enum LinkError {
    #[error("no motord runs on the robot")]
    NotRunning,
    #[error(transparent)]
    Instance(#[from] motord_ports::InstanceError),
    #[error(transparent)]
    Service(#[from] ServiceError),
    #[error("motord does not answer")]
    NoAnswer,
}

/// The connection to the daemon, while there is one.
#[derive(Debug, Default)]
pub(super) struct Link(Mutex<Option<Open>>);

#[derive(Debug)]
struct Open {
    ports: Arc<ClientPorts>,
    /// By group.
    setpoints: [Option<SetpointPort>; GROUPS_MAX],
}

impl Link {
    /// Connects to the daemon of `instance`.
    pub(super) fn open(&self, instance: &str) -> Result<Arc<ClientPorts>, LinkError> {
        let attachment = Instance::find(instance)?.attach()?.ok_or(LinkError::NotRunning)?;
        let ports = Arc::new(ClientPorts::open(attachment)?);
        *self.lock() = Some(Open { ports: Arc::clone(&ports), setpoints: [const { None }; GROUPS_MAX] });
        Ok(ports)
    }

    /// Gives up the connection.
    pub(super) fn close(&self) {
        *self.lock() = None;
    }

    /// Passes a setpoint to the daemon. Without one it is lost: no states arrive then, either.
    pub(super) fn send(&self, lease: Lease, setpoint: &SetpointMessage) {
        let mut open = self.lock();
        let Some(Open { ports, setpoints }) = open.as_mut() else { return };
        let slot = &mut setpoints[lease.group()];
        if slot.is_none() {
            *slot = ports.setpoint_port().ok();
        }
        if slot.as_ref().is_some_and(|port| port.send(setpoint).is_err()) {
            *slot = None;
        }
    }

    /// Sends a request, and waits for the answer at most a second.
    pub(super) fn ask(&self, request: AdminRequest) -> Result<(AdminReply, Vec<u8>), LinkError> {
        let ports = self.lock().as_ref().map(|open| Arc::clone(&open.ports));
        let question: Question = ports.ok_or(LinkError::NotRunning)?.ask(request)?;
        let end = clock::now_ns() + crate::frame::nanos(ANSWER_TIMEOUT);
        loop {
            if let Some(answer) = question.answer()? {
                return Ok(answer);
            }
            if clock::now_ns() >= end {
                return Err(LinkError::NoAnswer);
            }
            std::thread::sleep(ANSWER_POLL);
        }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Option<Open>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
