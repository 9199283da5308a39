//! The part of a state that belongs to a claim.

use crate::members::{JointKey, Members};
use crate::{Claim, Error, Group, Joint, State, Stop};
use motord_shared::{Operation, Phase};
use std::sync::Arc;

/// A claimed group and its joints after a cycle: `state.of(&claim)?`.
#[derive(Debug, Clone)]
pub struct GroupView<'a> {
    state: &'a State,
    members: Arc<Members>,
    group: Group,
}

impl State {
    /// Returns the group of `claim` in this state. Does not allocate.
    ///
    /// # Errors
    /// [`Error::Restarted`] when claim and state belong to different daemons; [`Error::Stopped`]
    /// when a stop of the active group ended the claim; [`Error::ClaimLost`] when another process
    /// did; [`Error::NotUnderstood`] when the state lacks a joint of the group.
    pub fn of(&self, claim: &Claim) -> Result<GroupView<'_>, Error> {
        let members = Arc::clone(claim.members());
        if self.boot_id() != members.boot_id {
            return Err(Error::Restarted);
        }
        let has_all = members.joints.iter().all(|&joint| joint < self.joints().len());
        let group = self.group(members.index).filter(|_| has_all);
        let group = group.ok_or(Error::NotUnderstood { operation: Operation::Describe })?;
        if self.cycle() > members.since && group.lease != Some(members.lease) {
            return Err(claim.end(&group));
        }
        Ok(GroupView { state: self, members, group })
    }
}

impl GroupView<'_> {
    /// Returns the group itself: phase, latched cause, counters.
    #[must_use]
    pub fn group(&self) -> Group {
        self.group
    }

    /// Returns the phase of the group. `None` for a code that this client does not know.
    #[must_use]
    pub fn phase(&self) -> Option<Phase> {
        self.group.phase
    }

    /// Returns `true` if the group follows setpoints.
    #[must_use]
    pub fn is_active(&self) -> bool {
        self.group.phase == Some(Phase::Active)
    }

    /// Returns the reason why the group was stopped; `None` when no cause is latched.
    #[must_use]
    pub fn stop(&self) -> Option<Stop> {
        let joint = || self.group.cause_joint.and_then(|joint| self.members.name_of(joint));
        self.group.latched.then(|| Stop::of(&self.group, joint()))
    }

    /// Checks that the group follows setpoints.
    ///
    /// # Errors
    /// [`Error::Stopped`] with the cause when the group does not follow setpoints.
    pub fn must_be_active(&self) -> Result<(), Error> {
        if self.is_active() {
            return Ok(());
        }
        let starting = self.phase() == Some(Phase::Starting);
        let stop = self.stop().unwrap_or(if starting { Stop::Starting } else { Stop::Disabled });
        Err(Error::Stopped { group: self.members.name.clone(), stop })
    }

    /// Returns a joint, by its name or slot.
    ///
    /// # Errors
    /// [`Error::UnknownJoint`], which lists the joints of the group; [`Error::OtherClaim`].
    pub fn joint(&self, joint: impl JointKey) -> Result<Joint, Error> {
        Ok(self.at(joint.joint_index(&self.members)?))
    }

    /// Returns the position of a joint, rad.
    ///
    /// # Errors
    /// Those of [`joint`](Self::joint); [`Error::NotHeard`] while the motor has not reported it.
    pub fn position(&self, joint: impl JointKey) -> Result<f32, Error> {
        let index = joint.joint_index(&self.members)?;
        let unreported = || Error::NotHeard { joint: self.members.names[index].clone() };
        self.at(index).position().ok_or_else(unreported)
    }

    /// Returns the positions of all joints, rad, in the order of the group. Allocates.
    ///
    /// # Errors
    /// [`Error::NotHeard`] while a motor, also of an excluded joint, has not reported its position.
    pub fn positions(&self) -> Result<Vec<f32>, Error> {
        self.members.names.iter().map(|name| self.position(name)).collect()
    }

    /// Returns every joint of the group with its name, in the order of the group.
    pub fn joints(&self) -> impl ExactSizeIterator<Item = (&str, Joint)> {
        self.members.names.iter().enumerate().map(|(index, name)| (name.as_str(), self.at(index)))
    }

    /// Returns `true` if every motor of the group has reported its position since it came online.
    /// Excluded joints do not count.
    #[must_use]
    pub fn is_heard(&self) -> bool {
        self.joints().all(|(_, joint)| joint.is_excluded() || joint.position().is_some())
    }

    /// [`State::of`] has checked that the state contains every joint of the group.
    fn at(&self, index: usize) -> Joint {
        self.state.joint(self.members.joints[index]).expect("the state has every joint of the group")
    }
}
