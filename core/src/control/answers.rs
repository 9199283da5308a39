//! Answers to administrative requests.

use motord_shared::{AdminReply, Refusal};

/// A refusal, and its detail: the joint, process id or cause that it is about.
pub(super) type Refused = (Refusal, u32);

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
            *free = Some((ticket, reply(outcome.map(|()| 0))));
            self.len += 1;
        }
    }

    /// The newest of them: each bears its ticket, so their order means nothing.
    pub(super) fn pop(&mut self) -> Option<(u32, AdminReply)> {
        self.len = self.len.checked_sub(1)?;
        self.answers[self.len].take()
    }
}

/// The reply with the lease or the reason of a refusal.
pub(super) fn reply(outcome: Result<u64, Refused>) -> AdminReply {
    match outcome {
        Ok(lease) => AdminReply { lease, refusal: 0, detail: 0 },
        Err((refusal, detail)) => AdminReply { lease: 0, refusal: refusal.code(), detail },
    }
}
