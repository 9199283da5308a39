//! The records of the cycles: each the state of one, with the setpoints that it used.

use motord_shared::limits::GROUPS_MAX;
use motord_shared::{CycleRecord, Lease, SetpointMessage, StateMessage};

/// The setpoint in use is one of the last that came: the cycle takes the newest in each tick, and
/// keeps it when a newer one has an error.
const RECENT: usize = 4;

/// The last messages of a group's owner.
#[derive(Default)]
struct Recent {
    messages: [Box<SetpointMessage>; RECENT],
    next: usize,
}

/// Puts the records together.
pub struct Records {
    /// The joints of each group.
    joints: Vec<Vec<usize>>,
    recent: [Recent; GROUPS_MAX],
    record: Box<CycleRecord>,
}

impl Records {
    /// For groups of these joints.
    #[must_use]
    pub fn new(joints: Vec<Vec<usize>>) -> Self {
        Self { joints, recent: Default::default(), record: Box::default() }
    }

    /// `message` of the owner of a group goes to the cycle.
    pub fn note(&mut self, message: &SetpointMessage) {
        let group = Lease::from_raw(message.lease).map(Lease::group);
        if let Some(recent) = group.and_then(|group| self.recent.get_mut(group)) {
            recent.messages[recent.next].copy_from(message);
            recent.next = (recent.next + 1) % RECENT;
        }
    }

    /// The record of the cycle that has published `state`. Does not allocate.
    pub fn next(&mut self, state: &StateMessage) -> &CycleRecord {
        let Self { joints, recent, record, .. } = self;
        record.sequence += 1;
        record.known = 0;
        record.state.copy_from(state);
        for ((group, recent), joints) in state.groups().iter().zip(recent.iter()).zip(joints.iter()) {
            let has_setpoint = group.sequence != 0;
            let used = recent.messages.iter().find(|message| {
                has_setpoint && message.lease == group.lease && message.sequence == group.sequence
            });
            let Some(used) = used else { continue };
            for (joint, setpoint) in joints.iter().zip(&used.joints) {
                record.set_setpoint(*joint, *setpoint);
            }
        }
        record
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_shared::JointSetpoint;

    fn message(lease: Lease, sequence: u64, position: f32) -> SetpointMessage {
        let mut message =
            SetpointMessage { lease: lease.raw(), sequence, joint_count: 2, ..SetpointMessage::default() };
        message.joints.fill(JointSetpoint { position, ..JointSetpoint::default() });
        message
    }

    fn state(lease: Lease, sequence: u64) -> StateMessage {
        let mut state = StateMessage { group_count: 2, ..StateMessage::default() };
        state.groups[1].lease = lease.raw();
        state.groups[1].sequence = sequence;
        state
    }

    #[test]
    fn record_holds_the_setpoint_used_by_its_cycle() {
        let lease = Lease::new(9, 7, 1).unwrap();
        let mut records = Records::new(vec![vec![0, 2], vec![1, 3]]);
        for sequence in 1..=RECENT as u64 + 1 {
            records.note(&message(lease, sequence, sequence as f32));
        }
        let record = records.next(&state(lease, 3));
        assert_eq!(record.setpoint(1).map(|setpoint| setpoint.position), Some(3.0));
        assert_eq!(record.setpoint(3).map(|setpoint| setpoint.position), Some(3.0));
        assert_eq!((record.setpoint(0), record.setpoint(2)), (None, None));
        assert_eq!(records.next(&state(lease, 1)).known, 0, "it came too long ago");
        assert_eq!(records.next(&state(lease, 0)).known, 0, "none is in use");
        assert_eq!(records.next(&state(Lease::new(9, 8, 1).unwrap(), 3)).known, 0, "of another owner");
        assert_eq!(records.next(&state(lease, 4)).sequence, 5);
    }
}
