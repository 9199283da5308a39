//! The right to move a group of joints.

use crate::link::{ANSWER_TIMEOUT, Link, Subject};
use crate::{Error, Setpoint};
use motord_shared::description::RobotDescription;
use motord_shared::ports::SetpointPort;
use motord_shared::{Lease, Operation, SetpointMessage, clock};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How long dropping a claim may take. A daemon that does not hear of it finds out by the setpoints that stop.
const RELEASE_TIMEOUT: Duration = Duration::from_millis(100);

/// How often a setpoint is repeated until the daemon has it: about a cycle.
const REPEAT_PERIOD: Duration = Duration::from_millis(1);

/// Ownership of a group. Dropping it releases the group, which stops it when it was active.
#[derive(Debug)]
pub struct Claim {
    link: Arc<Link>,
    port: SetpointPort,
    boot_id: u64,
    index: usize,
    name: String,
    joints: Vec<usize>,
    lease: Lease,
    /// The last setpoints that were sent; sequence 0 before the first.
    message: SetpointMessage,
    released: bool,
}

impl Claim {
    /// Claims the group with this index of `robot`.
    pub(crate) fn new(link: Arc<Link>, robot: &RobotDescription, index: usize) -> Result<Self, Error> {
        let group = robot.groups[index].clone();
        let port = link.setpoint_port()?;
        let subject = Subject { group: index, ..Subject::default() };
        let (reply, _) = link.ask(Operation::Claim, subject, ANSWER_TIMEOUT)?;
        let lease =
            Lease::from_raw(reply.lease).ok_or(Error::NotUnderstood { operation: Operation::Claim })?;
        Ok(Self {
            link,
            port,
            boot_id: robot.boot_id,
            index,
            name: group.name,
            message: SetpointMessage {
                lease: lease.raw(),
                joint_count: group.joints.len() as u32,
                ..SetpointMessage::default()
            },
            joints: group.joints,
            lease,
            released: false,
        })
    }

    /// Name of the group.
    #[must_use]
    pub fn group(&self) -> &str {
        &self.name
    }

    /// Index of the group in the description.
    #[must_use]
    pub fn index(&self) -> usize {
        self.index
    }

    /// The joints of the group, by index in the description. Setpoints stand in this order.
    #[must_use]
    pub fn joints(&self) -> &[usize] {
        &self.joints
    }

    /// Sends one setpoint per joint. The newest setpoint wins; what the daemon has not read is replaced. Does not wait.
    /// Whether it was accepted shows in the counters and the `applied` of the next states.
    ///
    /// # Errors
    /// [`Error::SetpointCount`]; [`Error::Restarted`], now and ever after a restart; [`Error::NotRunning`] or
    /// [`Error::Silent`] when states have stopped, though the setpoint was sent.
    pub fn send(&mut self, setpoints: &[Setpoint]) -> Result<(), Error> {
        let (expected, received) = (self.joints.len(), setpoints.len());
        if expected != received {
            return Err(Error::SetpointCount { expected, received });
        }
        self.refresh()?;
        self.message.cycle = self.link.cycle();
        for (joint, setpoint) in self.message.joints.iter_mut().zip(setpoints) {
            *joint = (*setpoint).into();
        }
        self.transmit()?;
        self.link.check_alive()
    }

    /// Starts the motors of the group, towards the last setpoint, which must be near to where the joints are. It is
    /// repeated until the daemon has answered, within a few cycles; from then on the caller must go on sending.
    ///
    /// # Errors
    /// [`Error::Refused`] with the reason, [`Error::Restarted`], [`Error::NotRunning`], [`Error::Silent`],
    /// [`Error::NoAnswer`].
    pub fn enable(&mut self) -> Result<(), Error> {
        // The daemon reads requests and setpoints at different times of a cycle: without this the request could win.
        let (begun, before) = (Instant::now(), self.message.sequence);
        while before > 0 && !self.is_heard(before)? && begun.elapsed() < ANSWER_TIMEOUT {
            self.transmit()?;
            std::thread::sleep(REPEAT_PERIOD);
        }
        self.ready()?;
        let link = Arc::clone(&self.link);
        link.ask_while(Operation::Enable, self.subject(), ANSWER_TIMEOUT, || match before {
            0 => Ok(()),
            _ => self.transmit(),
        })?;
        Ok(())
    }

    /// Damps and stops the motors of the group.
    ///
    /// # Errors
    /// Those of [`enable`](Self::enable).
    pub fn disable(&mut self) -> Result<(), Error> {
        self.operate(Operation::Disable)
    }

    /// Takes back the latched cause of a stop.
    ///
    /// # Errors
    /// Those of [`enable`](Self::enable).
    pub fn reset(&mut self) -> Result<(), Error> {
        self.operate(Operation::Reset)
    }

    /// Gives the group up.
    ///
    /// # Errors
    /// Those of [`enable`](Self::enable). The claim is gone in any case.
    pub fn release(mut self) -> Result<(), Error> {
        self.released = true;
        self.operate(Operation::Release)
    }

    /// Sends the message again, as a new one.
    fn transmit(&mut self) -> Result<(), Error> {
        self.message.sequence += 1;
        self.message.time_ns = clock::now_ns();
        let sent = self.port.send(&self.message);
        sent.map_err(|error| Error::of_service(error, self.link.instance()))
    }

    /// Whether the daemon has accepted a setpoint of this claim that was sent after the one with sequence `before`.
    fn is_heard(&self, before: u64) -> Result<bool, Error> {
        self.ready()?;
        let group = self.link.try_group(self.index);
        Ok(group.is_some_and(|group| group.lease == Some(self.lease) && group.sequence > before))
    }

    fn operate(&self, operation: Operation) -> Result<(), Error> {
        self.ready()?;
        self.link.ask(operation, self.subject(), ANSWER_TIMEOUT)?;
        Ok(())
    }

    fn subject(&self) -> Subject {
        Subject { lease: Some(self.lease), group: self.index, ..Subject::default() }
    }

    /// Whether the daemon that granted the claim lives.
    fn ready(&self) -> Result<(), Error> {
        self.refresh()?;
        self.link.check_alive()
    }

    /// Takes in the states that have arrived, and checks that they are of the daemon that granted the claim.
    fn refresh(&self) -> Result<(), Error> {
        self.link.refresh()?;
        if self.link.robot().boot_id == self.boot_id { Ok(()) } else { Err(Error::Restarted) }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        if self.released || self.link.check_alive().is_err() {
            return;
        }
        // A drop has nobody to tell: the daemon notices the silence if this does not reach it.
        let _ = self.link.ask(Operation::Release, self.subject(), RELEASE_TIMEOUT);
    }
}
