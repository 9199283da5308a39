//! The joints of a claimed group, by name.

use crate::{Error, Setpoint};
use motord_shared::Lease;
use motord_shared::description::{JointLimits, RobotDescription};
use std::time::Duration;

/// The index of a joint in its claim's group, for repeated use: `claim.slot("fl-knee")?`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Slot {
    lease: Lease,
    index: usize,
}

/// A joint of a claimed group: its name, or its [`Slot`], which saves the comparison of names.
pub trait JointKey: sealed::Sealed {
    #[doc(hidden)]
    fn joint_index(&self, members: &Members) -> Result<usize, Error>;
}

mod sealed {
    /// Restricts keys to names and slots.
    pub trait Sealed {}
    impl Sealed for &str {}
    impl Sealed for &String {}
    impl Sealed for super::Slot {}
}

impl JointKey for &str {
    fn joint_index(&self, members: &Members) -> Result<usize, Error> {
        members.joint_index(self)
    }
}

impl JointKey for &String {
    fn joint_index(&self, members: &Members) -> Result<usize, Error> {
        members.joint_index(self)
    }
}

impl JointKey for Slot {
    /// A slot of another claim may mean another joint.
    fn joint_index(&self, members: &Members) -> Result<usize, Error> {
        if self.lease == members.lease { Ok(self.index) } else { Err(Error::OtherClaim) }
    }
}

/// A claimed group.
#[derive(Debug)]
pub struct Members {
    pub(crate) boot_id: u64,
    pub(crate) lease: Lease,
    /// Number of the newest cycle when the group was claimed. States of later cycles contain the
    /// lease while it is valid.
    pub(crate) since: u64,
    /// Name of the group, and its index in the description.
    pub(crate) name: String,
    pub(crate) index: usize,
    /// The joints, by index in the description.
    pub(crate) joints: Vec<usize>,
    pub(crate) names: Vec<String>,
    pub(crate) limits: Vec<JointLimits>,
    pub(crate) timeout: Duration,
    pub(crate) horizon_max: Duration,
}

impl Members {
    /// Creates the group with this index of `robot`.
    pub(crate) fn new(robot: &RobotDescription, index: usize, lease: Lease, since: u64) -> Self {
        let group = &robot.groups[index];
        let joints = || group.joints.iter().map(|&joint| &robot.joints[joint]);
        Self {
            boot_id: robot.boot_id,
            lease,
            since,
            name: group.name.clone(),
            index,
            joints: group.joints.clone(),
            names: joints().map(|joint| joint.name.clone()).collect(),
            limits: joints().map(|joint| joint.limits).collect(),
            timeout: robot.setpoint_timeout,
            horizon_max: robot.setpoint_horizon_max,
        }
    }

    pub(crate) fn slot(&self, name: &str) -> Result<Slot, Error> {
        Ok(Slot { lease: self.lease, index: self.joint_index(name)? })
    }

    /// Returns the slots of all joints, in the order of `names`.
    pub(crate) fn order<'n>(&self, names: impl Iterator<Item = &'n str>) -> Result<Vec<Slot>, Error> {
        let bad = |index: usize, is_doubled| {
            let (joint, known) = (self.names[index].clone(), self.names.join(", "));
            Error::JointOrder { joint, is_doubled, known }
        };
        let (mut slots, mut is_named) = (Vec::new(), vec![false; self.names.len()]);
        for name in names {
            let slot = self.slot(name)?;
            if std::mem::replace(&mut is_named[slot.index], true) {
                return Err(bad(slot.index, true));
            }
            slots.push(slot);
        }
        is_named.iter().position(|is_named| !is_named).map_or(Ok(slots), |index| Err(bad(index, false)))
    }

    /// Returns `setpoint`, for the joint at `index`, if the daemon would accept its values.
    pub(crate) fn checked(&self, index: usize, setpoint: Setpoint) -> Result<Setpoint, Error> {
        match setpoint.rejection() {
            Some(rejection) => Err(Error::BadSetpoint { joint: self.names[index].clone(), rejection }),
            None => Ok(setpoint),
        }
    }

    /// Returns the name of the joint with this index in the description, if it belongs to the
    /// group.
    pub(crate) fn name_of(&self, joint: usize) -> Option<String> {
        let index = self.joints.iter().position(|&own| own == joint)?;
        self.names.get(index).cloned()
    }

    fn joint_index(&self, name: &str) -> Result<usize, Error> {
        let unknown = || Error::UnknownJoint { name: name.to_owned(), known: self.names.join(", ") };
        self.names.iter().position(|known| known == name).ok_or_else(unknown)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_shared::description::{GroupDescription, JointDescription};

    fn members() -> Members {
        let joint = |name: &str| JointDescription { name: name.to_owned(), ..JointDescription::default() };
        let group = GroupDescription { joints: vec![1, 2, 3], ..GroupDescription::default() };
        let robot = RobotDescription {
            joints: ["tail", "hip", "thigh", "knee"].map(joint).to_vec(),
            groups: vec![group],
            ..RobotDescription::default()
        };
        Members::new(&robot, 0, Lease::new(7, 1, 0).expect("it is a lease"), 0)
    }

    #[test]
    fn order_of_names_is_that_of_slots() {
        let slots = members().order(["knee", "hip", "thigh"].into_iter()).expect("each is named once");
        assert_eq!(slots.iter().map(|slot| slot.index).collect::<Vec<_>>(), [2, 0, 1]);
    }

    #[test]
    fn unfit_order_names_the_joint() {
        let refused = |names: &[&str]| members().order(names.iter().copied()).unwrap_err().to_string();
        let known = "there are hip, thigh, knee";
        assert_eq!(refused(&["knee", "tail", "thigh"]), format!("there is no joint \"tail\"; {known}"));
        assert_eq!(refused(&["knee", "hip", "knee"]), format!("knee is twice in the names; {known}"));
        assert_eq!(refused(&["knee", "hip"]), format!("thigh is not in the names; {known}"));
    }
}
