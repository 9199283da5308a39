//! A group of joints, and what the threads of the bridge share about it.

use crate::claim_gate::ClaimGate;
use crate::command::Command;
use crate::config::Gains;
use crate::refusal::Counters;
use crate::slot::Slot;
use motord_client::{JointLimits, RobotDescription};
use std::sync::Arc;

/// A joint of a group.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GroupJoint {
    pub(crate) name: String,
    /// Index in the robot description.
    pub(crate) index: usize,
    pub(crate) limits: JointLimits,
}

/// A group as the daemon describes it. Its order of joints is that of setpoints.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Group {
    pub(crate) name: String,
    /// Index in the robot description.
    pub(crate) index: usize,
    pub(crate) joints: Vec<GroupJoint>,
}

impl Group {
    /// Returns the groups of `robot`.
    pub(crate) fn all(robot: &RobotDescription) -> Vec<Self> {
        let joint = |index: &usize| {
            let joint = robot.joints.get(*index)?;
            Some(GroupJoint { name: joint.name.clone(), index: *index, limits: joint.limits })
        };
        let group = |(index, group): (usize, &motord_client::GroupDescription)| {
            let joints = group.joints.iter().filter_map(joint).collect();
            Self { name: group.name.clone(), index, joints }
        };
        robot.groups.iter().enumerate().map(group).collect()
    }
}

/// The gains of the forms of a command without gains, in the group's order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct JointGains {
    /// N·m/rad.
    pub(crate) kp: Vec<f64>,
    /// N·m·s/rad.
    pub(crate) kd: Vec<f64>,
}

/// A group, and what its threads exchange.
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
