//! The values that the threads of the bridge exchange about a group.

use crate::claim_gate::ClaimGate;
use crate::command::Command;
use crate::config::Gains;
use crate::group::{Group, JointGains};
use crate::refusal::Counters;
use crate::slot::Slot;
use std::sync::Arc;

/// A group, and the values that its threads exchange.
#[derive(Debug)]
pub(crate) struct GroupLink {
    pub(crate) group: Group,
    pub(crate) gains: Option<JointGains>,
    pub(crate) gate: ClaimGate,
    pub(crate) command: Slot<Command>,
    pub(crate) counters: Counters,
}

impl GroupLink {
    /// Creates the link of a group. Fails with a sentence if `gains` has another number of joints.
    pub(crate) fn new(group: Group, gains: Option<&Gains>) -> Result<Arc<Self>, String> {
        let count = group.joints.len();
        let of_joints = |gains: &Gains| {
            let (kp, kd) = gains.kp.of(count).zip(gains.kd.of(count)).ok_or_else(|| {
                format!("[group.{}] needs one number, or {count} numbers for kp and for kd", group.name)
            })?;
            Ok::<_, String>(JointGains { kp, kd })
        };
        let gains = gains.map(of_joints).transpose()?;
        let (gate, command, counters) = (ClaimGate::default(), Slot::default(), Counters::default());
        Ok(Arc::new(Self { group, gains, gate, command, counters }))
    }
}
