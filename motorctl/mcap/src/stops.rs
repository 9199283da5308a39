//! The safe stops of a robot, cycle by cycle.

use motord_shared::limits::GROUPS_MAX;
use motord_shared::message::FLAG_SHUTDOWN;
use motord_shared::{Cause, CycleRecord};

/// Detects the groups that are stopped for a cause.
#[derive(Debug, Default)]
pub struct Stops {
    /// The causes of the previous cycle, by group; `None` before the first.
    causes: Option<[u32; GROUPS_MAX]>,
    is_leaving: bool,
}

impl Stops {
    /// Returns the cause if a group was stopped in this cycle. A cause latched before the first
    /// cycle does not count.
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

    /// Returns `true` if the daemon was shutting down in the last cycle: a missing next cycle is
    /// then no death.
    #[must_use]
    pub fn is_leaving(&self) -> bool {
        self.is_leaving
    }
}
