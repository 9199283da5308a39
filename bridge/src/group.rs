//! A group of joints.

use motord_client::{JointLimits, RobotDescription};

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
