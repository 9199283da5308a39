//! The ports of the daemon, opened again after its death.

use motord_ports::{ClientPorts, ImuSender, Instance, Question, ServiceError, SetpointPort, clock};
use motord_shared::limits::GROUPS_MAX;
use motord_shared::message::{AdminReply, ImuMessage};
use motord_shared::{AdminRequest, Lease, SetpointMessage};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Longest time for the daemon's answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);
/// Interval of the checks for an answer.
const ANSWER_POLL: Duration = Duration::from_micros(200);
/// Interval of attempts to open the port for samples: a robot without an external IMU has none.
const RETRY: Duration = Duration::from_secs(1);

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
    imus: Option<ImuSender>,
    /// Time of the last attempt to open `imus`.
    tried: Option<Instant>,
}

impl Open {
    fn setpoints(&mut self, lease: Lease) -> &mut Option<SetpointPort> {
        let slot = &mut self.setpoints[lease.group()];
        if slot.is_none() {
            *slot = self.ports.setpoint_port().ok();
        }
        slot
    }

    fn imus(&mut self) -> Option<&ImuSender> {
        if self.imus.is_none() && self.tried.is_none_or(|tried| tried.elapsed() >= RETRY) {
            self.tried = Some(Instant::now());
            self.imus = self.ports.imu_sender().ok();
        }
        self.imus.as_ref()
    }
}

impl Link {
    /// Connects to the daemon of `instance`.
    pub(super) fn open(&self, instance: &str) -> Result<Arc<ClientPorts>, LinkError> {
        let attachment = Instance::find(instance)?.attach()?.ok_or(LinkError::NotRunning)?;
        let ports = Arc::new(ClientPorts::open(attachment)?);
        let setpoints = [const { None }; GROUPS_MAX];
        *self.lock() = Some(Open { ports: Arc::clone(&ports), setpoints, imus: None, tried: None });
        Ok(ports)
    }

    /// Gives up the connection.
    pub(super) fn close(&self) {
        *self.lock() = None;
    }

    /// Returns the ports of the daemon, while it runs.
    pub(super) fn ports(&self) -> Option<Arc<ClientPorts>> {
        self.lock().as_ref().map(|open| Arc::clone(&open.ports))
    }

    /// Passes a sample of an external IMU to the daemon. A robot without such an IMU has no use for
    /// it.
    pub(super) fn send_sample(&self, sample: &ImuMessage) {
        let mut open = self.lock();
        let Some(open) = open.as_mut() else { return };
        if open.imus().is_some_and(|port| port.send(sample).is_err()) {
            open.imus = None;
        }
    }

    /// Opens the port for the setpoints of a group that was claimed: the first setpoint does not wait
    /// for it.
    pub(super) fn prepare(&self, lease: Lease) {
        if let Some(open) = self.lock().as_mut() {
            open.setpoints(lease);
        }
    }

    /// Passes a setpoint to the daemon. Without one it is lost: no states arrive then, either.
    pub(super) fn send(&self, lease: Lease, setpoint: &SetpointMessage) {
        let mut open = self.lock();
        let Some(open) = open.as_mut() else { return };
        let slot = open.setpoints(lease);
        if slot.as_ref().is_some_and(|port| port.send(setpoint).is_err()) {
            *slot = None;
        }
    }

    /// Sends a request, and waits for the answer at most a second.
    pub(super) fn ask(&self, request: AdminRequest) -> Result<(AdminReply, Vec<u8>), LinkError> {
        let question: Question = self.ports().ok_or(LinkError::NotRunning)?.ask(request)?;
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
