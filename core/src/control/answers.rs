//! Answers to administrative requests, with their codes and sentinels of the wire.

use motord_shared::codes::Detail;
use motord_shared::{AdminReply, Cause, Lease, Refusal, message};

/// A refusal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Refused {
    reason: Refusal,
    about: About,
}

/// The object that a refusal is about.
#[derive(Debug, Clone, Copy, PartialEq)]
enum About {
    Nothing,
    Joint(usize),
    Process(u32),
    Cause(Cause),
    /// A number of the request that is no operation, group or joint.
    Unknown(u32),
}

impl Refused {
    /// Refuses without naming an object.
    pub(super) const fn new(reason: Refusal) -> Self {
        Self { reason, about: About::Nothing }
    }

    /// Refuses because of a joint.
    pub(super) const fn joint(reason: Refusal, joint: usize) -> Self {
        Self { reason, about: About::Joint(joint) }
    }

    /// Refuses because a process owns the group.
    pub(super) const fn owned(pid: u32) -> Self {
        Self { reason: Refusal::Owned, about: About::Process(pid) }
    }

    /// Refuses because a cause is latched.
    pub(super) const fn latched(cause: Cause) -> Self {
        Self { reason: Refusal::Latched, about: About::Cause(cause) }
    }

    /// Refuses because `number` names no operation, group or joint.
    pub(super) const fn unknown(reason: Refusal, number: u32) -> Self {
        Self { reason, about: About::Unknown(number) }
    }

    const fn detail(self) -> u32 {
        match self.about {
            About::Nothing if matches!(self.reason.detail(), Detail::Joint) => message::NO_JOINT,
            About::Nothing => 0,
            About::Joint(joint) => joint as u32,
            About::Process(pid) => pid,
            About::Cause(cause) => cause.code(),
            About::Unknown(number) => number,
        }
    }
}

/// The reply with the lease that was granted, if one was, or with the reason of a refusal.
pub(super) fn reply(outcome: Result<Option<Lease>, Refused>) -> AdminReply {
    match outcome {
        Ok(lease) => AdminReply { lease: lease.map_or(0, Lease::raw), refusal: 0, detail: 0 },
        Err(refused) => AdminReply { lease: 0, refusal: refused.reason.code(), detail: refused.detail() },
    }
}

/// Answers that came later than their request.
#[derive(Debug)]
pub(super) struct Answers {
    answers: [Option<(u32, AdminReply)>; Answers::CAPACITY],
    len: usize,
}

impl Answers {
    /// At most one service request per motor is under way.
    const CAPACITY: usize = motord_shared::limits::JOINTS_MAX;

    pub(super) const fn new() -> Self {
        Self { answers: [None; Self::CAPACITY], len: 0 }
    }

    pub(super) fn push(&mut self, ticket: u32, outcome: Result<(), Refused>) {
        if let Some(free) = self.answers.get_mut(self.len) {
            *free = Some((ticket, reply(outcome.map(|()| None))));
            self.len += 1;
        }
    }

    /// Takes the newest of them: each has its ticket, so their order is not significant.
    pub(super) fn pop(&mut self) -> Option<(u32, AdminReply)> {
        self.len = self.len.checked_sub(1)?;
        self.answers[self.len].take()
    }
}
