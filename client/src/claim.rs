//! The right to move a group of joints.

use crate::link::{ANSWER_TIMEOUT, Link, Subject};
use crate::{Error, Setpoint};
use motord_shared::ports::SetpointPort;
use motord_shared::{Operation, SetpointMessage, clock};
use std::cell::{RefCell, RefMut};
use std::rc::Rc;
use std::time::Duration;

/// How long dropping a claim may take. A daemon that does not hear of it finds out by the setpoints that stop.
const RELEASE_TIMEOUT: Duration = Duration::from_millis(100);

/// Ownership of a group. Dropping it releases the group, which stops it when it was active.
#[derive(Debug)]
pub struct Claim {
    link: Rc<RefCell<Link>>,
    port: SetpointPort,
    boot_id: u64,
    index: usize,
    name: String,
    joints: Vec<usize>,
    lease: u64,
    sequence: u64,
    released: bool,
}

impl Claim {
    pub(crate) fn new(link: Rc<RefCell<Link>>, index: usize) -> Result<Self, Error> {
        let connection = link.borrow();
        let group = connection.roster.groups[index].clone();
        let port = connection.setpoint_port()?;
        let (reply, _) = connection.ask(
            Operation::Claim,
            Subject { group: index, ..Subject::default() },
            ANSWER_TIMEOUT,
        )?;
        let boot_id = connection.boot_id;
        drop(connection);
        Ok(Self {
            link,
            port,
            boot_id,
            index,
            name: group.name,
            joints: group.joints,
            lease: reply.lease,
            sequence: 0,
            released: false,
        })
    }

    /// Name of the group.
    #[must_use]
    pub fn group(&self) -> &str {
        &self.name
    }

    /// Index of the group in the roster.
    #[must_use]
    pub fn index(&self) -> usize {
        self.index
    }

    /// The joints of the group, by index in the roster. Setpoints stand in this order.
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
        let cycle = self.polled()?.newest_cycle();
        self.sequence += 1;
        let mut message = SetpointMessage {
            lease: self.lease,
            sequence: self.sequence,
            cycle,
            joint_count: expected as u32,
            ..SetpointMessage::default()
        };
        for (joint, setpoint) in message.joints.iter_mut().zip(setpoints) {
            *joint = (*setpoint).into();
        }
        message.time_ns = clock::now_ns();
        let link = self.link.borrow();
        self.port.send(&message).map_err(|error| Error::of_service(error, link.instance()))?;
        link.check_alive()
    }

    /// Starts the motors of the group. Setpoints must be flowing, near to where the joints are, and must go on: the
    /// daemon answers within a cycle or two, and starts after that.
    ///
    /// # Errors
    /// [`Error::Refused`] with the reason, [`Error::Restarted`], [`Error::NotRunning`], [`Error::NoAnswer`].
    pub fn enable(&mut self) -> Result<(), Error> {
        self.operate(Operation::Enable)
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

    fn operate(&mut self, operation: Operation) -> Result<(), Error> {
        let subject = self.subject();
        self.polled()?.ask(operation, subject, ANSWER_TIMEOUT)?;
        Ok(())
    }

    fn subject(&self) -> Subject {
        Subject { lease: self.lease, group: self.index, ..Subject::default() }
    }

    /// The link, after taking in what has arrived, as long as it leads to the daemon that granted the claim.
    fn polled(&self) -> Result<RefMut<'_, Link>, Error> {
        let mut link = self.link.borrow_mut();
        link.poll()?;
        if link.boot_id == self.boot_id { Ok(link) } else { Err(Error::Restarted) }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        let link = self.link.borrow();
        if self.released || link.boot_id != self.boot_id || link.check_alive().is_err() {
            return;
        }
        // A drop has nobody to tell: the daemon notices the silence if this does not reach it.
        let _ = link.ask(Operation::Release, self.subject(), RELEASE_TIMEOUT);
    }
}
