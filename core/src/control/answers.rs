//! Answers to administrative requests.

use motord_shared::{AdminReply, Refusal};

/// A refusal, and its detail: the joint, process id or cause that it is about.
pub(super) type Refused = (Refusal, u32);

/// Answers that came later than their request.
#[derive(Debug)]
pub(super) struct Answers {
    answers: [Option<(u32, AdminReply)>; Answers::CAPACITY],
}

impl Answers {
    /// At most one service request per motor is under way.
    const CAPACITY: usize = motord_shared::limits::JOINTS_MAX;

    pub(super) const fn new() -> Self {
        Self { answers: [None; Self::CAPACITY] }
    }

    pub(super) fn push(&mut self, ticket: u32, outcome: Result<(), Refused>) {
        if let Some(free) = self.answers.iter_mut().find(|answer| answer.is_none()) {
            *free = Some((ticket, reply(outcome.map(|()| 0))));
        }
    }

    pub(super) fn pop(&mut self) -> Option<(u32, AdminReply)> {
        self.answers.iter_mut().find_map(Option::take)
    }
}

/// The reply with the lease or the reason of a refusal.
pub(super) fn reply(outcome: Result<u64, Refused>) -> AdminReply {
    match outcome {
        Ok(lease) => AdminReply { lease, refusal: 0, detail: 0 },
        Err((refusal, detail)) => AdminReply { lease: 0, refusal: refusal.code(), detail },
    }
}
