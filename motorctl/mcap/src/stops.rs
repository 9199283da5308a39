//! The safe stops of a robot, cycle by cycle.

use motord_shared::limits::GROUPS_MAX;
use motord_shared::message::FLAG_SHUTDOWN;
use motord_shared::{Cause, CycleRecord};

/// Finds the groups that are stopped for a cause.
#[derive(Debug, Default)]
pub struct Stops {
    /// The causes of the cycle before, by group; `None` before the first.
    causes: Option<[u32; GROUPS_MAX]>,
    is_leaving: bool,
}

impl Stops {
    /// Why a group was stopped in this cycle; `None` when none was. What is latched in the first cycle was no stop of it.
    pub fn of(&mut self, record: &CycleRecord) -> Option<Cause> {
        self.is_leaving = record.state.flags & FLAG_SHUTDOWN != 0;
        let mut causes = [0; GROUPS_MAX];
        for (cause, group) in causes.iter_mut().zip(record.state.groups()) {
            *cause = group.cause;
        }
        let known = self.causes.replace(causes).unwrap_or(causes);
        let changed = causes.iter().zip(known).find(|(cause, known)| **cause != *known && **cause != 0);
        changed.and_then(|(cause, _)| Cause::try_from(*cause).ok())
    }

    /// Whether the daemon was shutting down in the last cycle: then it has not died when no cycle follows.
    #[must_use]
    pub fn is_leaving(&self) -> bool {
        self.is_leaving
    }
}
