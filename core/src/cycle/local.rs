//! Owner and operator in the same program as the cycle: no service, no other process.
//!
//! A physics engine or a test runs the cycle itself, one call after another, and talks to it here. Every rule holds as it
//! does for clients in other processes: leases, the silence of an owner, limits, refusals.

use super::link::{Alarms, Ends, Record};
use super::replacement::Supply;
use crate::control::Event;
use motord_bus::Instant;
use motord_shared::limits::{GROUPS_MAX, JOINTS_MAX};
use motord_shared::{
    AdminReply, AdminRequest, JointSetpoint, Lease, Operation, Refusal, SetpointMessage, StateMessage,
};

/// Cycles after which [`LocalClient::ask`] gives up. A request that a motor must confirm takes hundreds.
const ANSWER_CYCLES: u32 = 4000;

/// Owner of any number of groups, and operator. Does not block. [`Ends`] that nobody else uses are enough.
pub struct LocalClient {
    ends: Ends,
    owned: [Option<Owned>; GROUPS_MAX],
    tickets: u32,
}

/// A group that this client owns, as far as it knows.
#[derive(Debug, Clone, Copy)]
struct Owned {
    lease: Lease,
    sequence: u64,
}

impl LocalClient {
    /// Talks to the cycle that `ends` belong to.
    #[must_use]
    pub fn new(ends: Ends) -> Self {
        Self { ends, owned: [None; GROUPS_MAX], tickets: 0 }
    }

    /// The newest states; all zero before the first cycle.
    pub fn state(&mut self) -> &StateMessage {
        self.ends.states.read()
    }

    /// The lease of `group` that was granted last. It may be lost meanwhile: the states show the owner of a group.
    #[must_use]
    pub fn lease(&self, group: usize) -> Option<Lease> {
        self.owned.get(group).copied().flatten().map(|owned| owned.lease)
    }

    /// Asks in the name of the owner of `group`; without a lease, as an operator. `cycle` is called until the answer is
    /// there: it runs one cycle, or waits for one.
    ///
    /// # Errors
    ///
    /// Why the cycle refuses; [`Refusal::Busy`] when too many requests are under way, or after 4000 cycles without an answer.
    pub fn ask(
        &mut self,
        operation: Operation,
        group: usize,
        mut cycle: impl FnMut(),
    ) -> Result<AdminReply, Refusal> {
        let ticket = self.request(operation, group)?;
        for _ in 0..ANSWER_CYCLES {
            cycle();
            while let Some((answered, reply)) = self.answer() {
                if answered == ticket {
                    return outcome(reply);
                }
            }
        }
        Err(Refusal::Busy)
    }

    /// As [`ask`](Self::ask), without waiting. The [`answer`](Self::answer) will bear the ticket that is returned.
    ///
    /// # Errors
    ///
    /// [`Refusal::Busy`] when too many requests are under way.
    pub fn request(&mut self, operation: Operation, group: usize) -> Result<u32, Refusal> {
        self.post(AdminRequest {
            lease: self.lease(group).map_or(0, Lease::raw),
            operation: operation.code(),
            group: u32::try_from(group).unwrap_or(u32::MAX),
            pid: std::process::id(),
            ..AdminRequest::default()
        })
    }

    /// Posts any request, good or bad. The [`answer`](Self::answer) will bear the ticket that is returned.
    ///
    /// # Errors
    ///
    /// [`Refusal::Busy`] when too many requests are under way.
    pub fn post(&mut self, request: AdminRequest) -> Result<u32, Refusal> {
        self.tickets = self.tickets.wrapping_add(1);
        self.ends.requests.push((self.tickets, request)).map_err(|_| Refusal::Busy)?;
        Ok(self.tickets)
    }

    /// The next answer, if there is one. That to a claim makes this client the owner.
    pub fn answer(&mut self) -> Option<(u32, AdminReply)> {
        let (ticket, reply) = self.ends.answers.pop().ok()?;
        if let Some(lease) = Lease::from_raw(reply.lease) {
            self.owned[lease.group()] = Some(Owned { lease, sequence: 0 });
        }
        Some((ticket, reply))
    }

    /// The owner's next message to `group`, sent at `now`: one setpoint for each of its joints, joint side. The next cycle
    /// judges it, after the requests of that cycle. The states count what was accepted and what was rejected.
    ///
    /// # Errors
    ///
    /// [`Refusal::NotOwner`] when the group was never claimed here.
    pub fn send(&mut self, group: usize, now: Instant, joints: &[JointSetpoint]) -> Result<(), Refusal> {
        let message = self.message(group, now, joints).ok_or(Refusal::NotOwner)?;
        self.deliver(group, &message);
        Ok(())
    }

    /// The owner's next message to `group`, without sending it. Takes a sequence number. At most as many joints as a message
    /// holds are in it.
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

    /// Hands over any message, good or bad. It replaces the one before, if no cycle has taken that yet.
    pub fn deliver(&mut self, group: usize, message: &SetpointMessage) {
        if let Some(setpoints) = self.ends.setpoints.get_mut(group) {
            setpoints.write(*message);
        }
    }

    /// The next event with the number of its cycle. What nobody takes is dropped and counted.
    pub fn event(&mut self) -> Option<(u64, Event)> {
        self.ends.events.pop().ok()
    }

    /// The next cycle's record. What nobody takes is dropped and counted.
    pub fn record(&mut self) -> Option<Record> {
        self.ends.records.pop().ok()
    }

    /// Where the next cycle is told that the process of an owner has ended, or that every group must stop.
    #[must_use]
    pub fn alarms(&self) -> &Alarms {
        &self.ends.counters.alarms
    }

    /// Where a bus goes that was opened again.
    pub const fn supply(&mut self) -> &mut Supply {
        &mut self.ends.supply
    }
}

/// Whether a request was granted. A code that is none cannot come from a cycle in this program.
fn outcome(reply: AdminReply) -> Result<AdminReply, Refusal> {
    match reply.refusal {
        0 => Ok(reply),
        code => Err(Refusal::try_from(code).unwrap_or(Refusal::UnknownOperation)),
    }
}
