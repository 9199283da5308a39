//! Owner and operator in the same program as the cycle: no service, no other process.
//!
//! For a physics engine or a test that calls the cycle directly. The rules for clients in other
//! processes hold here: leases, setpoint timeouts, limits, refusals.

use super::link::{Alarms, Ends, Record};
use super::replacement::Supply;
use crate::control::{Event, ImuReading};
use motord_bus::Instant;
use motord_shared::limits::{GROUPS_MAX, JOINTS_MAX};
use motord_shared::{
    AdminReply, AdminRequest, JointSetpoint, Lease, Operation, Refusal, SetpointMessage, StateMessage,
};

/// Cycles after which [`LocalClient::ask`] gives up. A request that a motor must confirm takes
/// hundreds.
pub const ANSWER_CYCLES: u32 = 4000;

/// Owner of any number of groups, and operator. Does not block.
pub struct LocalClient {
    ends: Ends,
    owned: [Option<Owned>; GROUPS_MAX],
    tickets: u32,
}

/// A group that this client claimed. The lease may be lost.
#[derive(Debug, Clone, Copy)]
struct Owned {
    lease: Lease,
    sequence: u64,
}

impl LocalClient {
    /// Connects to the cycle of these `ends`.
    #[must_use]
    pub fn new(ends: Ends) -> Self {
        Self { ends, owned: [None; GROUPS_MAX], tickets: 0 }
    }

    /// Returns the newest states; all zero before the first cycle.
    pub fn state(&mut self) -> &StateMessage {
        self.ends.states.read()
    }

    /// Returns the last granted lease of `group`. It may be lost: the states contain the owner of a
    /// group.
    #[must_use]
    pub fn lease(&self, group: usize) -> Option<Lease> {
        self.owned.get(group).copied().flatten().map(|owned| owned.lease)
    }

    /// Sends a request as the owner of `group`; without a lease, as an operator. Calls `cycle`,
    /// which runs one cycle or waits for one, until the answer arrives.
    ///
    /// # Errors
    ///
    /// The refusal of the cycle; [`Refusal::Busy`] when too many requests are open, or after 4000
    /// cycles without an answer.
    pub fn ask(
        &mut self,
        operation: Operation,
        group: usize,
        mut cycle: impl FnMut(),
    ) -> Result<AdminReply, Refusal> {
        let ticket = self.request(operation, group)?;
        for _ in 0..ANSWER_CYCLES {
            cycle();
            if let Some(reply) = self.answer_to(ticket) {
                return outcome(reply);
            }
        }
        Err(Refusal::Busy)
    }

    /// Returns the reply to the request with this ticket, once it is answered. Drops the answers to
    /// earlier requests.
    pub fn answer_to(&mut self, ticket: u32) -> Option<AdminReply> {
        while let Some((answered, reply)) = self.answer() {
            if answered == ticket {
                return Some(reply);
            }
        }
        None
    }

    /// As [`ask`](Self::ask), without waiting. Returns the ticket of the [`answer`](Self::answer).
    ///
    /// # Errors
    ///
    /// [`Refusal::Busy`] when too many requests are open.
    pub fn request(&mut self, operation: Operation, group: usize) -> Result<u32, Refusal> {
        self.post(AdminRequest {
            lease: self.lease(group).map_or(0, Lease::raw),
            operation: operation.code(),
            group: u32::try_from(group).unwrap_or(u32::MAX),
            pid: std::process::id(),
            ..AdminRequest::default()
        })
    }

    /// Posts any request, valid or not. Returns the ticket of the [`answer`](Self::answer).
    ///
    /// # Errors
    ///
    /// [`Refusal::Busy`] when too many requests are open.
    pub fn post(&mut self, request: AdminRequest) -> Result<u32, Refusal> {
        self.tickets = self.tickets.wrapping_add(1);
        self.ends.requests.push((self.tickets, request)).map_err(|_| Refusal::Busy)?;
        Ok(self.tickets)
    }

    /// Returns the next answer, if any. The answer to a claim makes this client the owner.
    pub fn answer(&mut self) -> Option<(u32, AdminReply)> {
        let (ticket, reply) = self.ends.answers.pop().ok()?;
        if let Some(lease) = Lease::from_raw(reply.lease) {
            self.owned[lease.group()] = Some(Owned { lease, sequence: 0 });
        }
        Some((ticket, reply))
    }

    /// Sends the owner's next message to `group`, stamped `now`: one setpoint for each of its
    /// joints, joint side. The next cycle checks it, after its requests. The states count accepted
    /// and rejected messages.
    ///
    /// # Errors
    ///
    /// [`Refusal::NotOwner`] when the group was never claimed here.
    pub fn send(&mut self, group: usize, now: Instant, joints: &[JointSetpoint]) -> Result<(), Refusal> {
        let message = self.message(group, now, joints).ok_or(Refusal::NotOwner)?;
        self.deliver(group, &message);
        Ok(())
    }

    /// Returns the owner's next message to `group`, without sending it. Uses a sequence number.
    /// Joints beyond the size of a message are left out.
    pub fn message(
        &mut self,
        group: usize,
        now: Instant,
        joints: &[JointSetpoint],
    ) -> Option<SetpointMessage> {
        let owned = self.owned.get_mut(group)?.as_mut()?;
        owned.sequence += 1;
        let count = joints.len().min(JOINTS_MAX);
        let mut message = SetpointMessage {
            lease: owned.lease.raw(),
            sequence: owned.sequence,
            time_ns: now.as_nanos(),
            joint_count: count as u32,
            ..Default::default()
        };
        message.joints[..count].copy_from_slice(&joints[..count]);
        Some(message)
    }

    /// Sends any message, valid or not. It replaces the previous one, if no cycle has taken that
    /// yet.
    pub fn deliver(&mut self, group: usize, message: &SetpointMessage) {
        if let Some(setpoints) = self.ends.setpoints.get_mut(group) {
            setpoints.write(*message);
        }
    }

    /// Passes the reading of an IMU to the next cycle. It replaces the previous one, if no cycle
    /// has taken that yet. Ignored for an IMU that the settings do not have.
    pub fn sample_imu(&mut self, imu: usize, reading: ImuReading) {
        if let Some(input) = self.ends.imus.get_mut(imu) {
            input.write(reading);
        }
    }

    /// Returns the next event with the number of its cycle. Unread events are dropped and counted.
    pub fn event(&mut self) -> Option<(u64, Event)> {
        self.ends.events.pop().ok()
    }

    /// Returns the next cycle's record. Unread records are dropped and counted.
    pub fn record(&mut self) -> Option<Record> {
        self.ends.records.pop().ok()
    }

    /// Returns the alarms for the next cycle: an owner's process exited, or every group must stop.
    #[must_use]
    pub fn alarms(&self) -> &Alarms {
        &self.ends.counters.alarms
    }

    /// Returns the supply that takes reopened buses.
    pub const fn supply(&mut self) -> &mut Supply {
        &mut self.ends.supply
    }
}

/// Returns the refusal in a reply. An unknown code cannot come from a cycle in this program.
///
/// # Errors
///
/// The refusal.
pub fn outcome(reply: AdminReply) -> Result<AdminReply, Refusal> {
    match reply.refusal {
        0 => Ok(reply),
        code => Err(Refusal::try_from(code).unwrap_or(Refusal::UnknownOperation)),
    }
}
