//! A robot in a few lines, for a fleet: as JSON under `motord/<robot>/status`.

use motord_shared::description::RobotDescription;
use motord_shared::message::{FLAG_EMERGENCY_STOP, FLAG_SHUTDOWN, NO_JOINT};
use motord_shared::{Cause, GroupState, JointState, MotorMode, Phase, StateMessage};
use serde::{Deserialize, Serialize};

/// A robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Summary {
    /// Name in the network.
    pub(crate) robot: String,
    /// Version of motord.
    pub(crate) version: String,
    /// Another number after each start of motord.
    pub(crate) boot_id: u64,
    /// Cycles since the start, and missed ticks.
    pub(crate) cycle: u64,
    pub(crate) missed_ticks: u64,
    pub(crate) emergency_stop: bool,
    pub(crate) shutting_down: bool,
    /// Lowest supply voltage that a motor reports, V.
    pub(crate) battery_v: Option<f32>,
    /// Highest temperature that a motor reports, °C.
    pub(crate) hottest_celsius: Option<f32>,
    /// Number of motors.
    pub(crate) motors: usize,
    /// Joints whose motors do not answer, or report a fault.
    pub(crate) offline: Vec<String>,
    pub(crate) faulty: Vec<String>,
    pub(crate) groups: Vec<GroupSummary>,
}

/// A group.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct GroupSummary {
    pub(crate) name: String,
    /// As in `motorctl status`.
    pub(crate) phase: String,
    pub(crate) owned: bool,
    /// The latched cause, with the joint and the next step.
    pub(crate) cause: Option<String>,
    pub(crate) joint: Option<String>,
    pub(crate) advice: Option<String>,
}

impl Summary {
    /// Returns the summary of `state`, which belongs to the robot of the description.
    pub(crate) fn of(robot: &str, description: &RobotDescription, state: &StateMessage) -> Self {
        let joints = || description.joints.iter().map(|joint| &joint.name).zip(state.joints());
        let named = |is: fn(&JointState) -> bool| {
            joints().filter(|(_, joint)| is(joint)).map(|(name, _)| name.clone()).collect()
        };
        let numbers = |of: fn(&JointState) -> f32| {
            joints().map(move |(_, joint)| of(joint)).filter(|value| value.is_finite())
        };
        let groups = description.groups.iter().zip(state.groups());
        Self {
            robot: robot.to_owned(),
            version: description.version.clone(),
            boot_id: state.boot_id,
            cycle: state.cycle,
            missed_ticks: state.overruns,
            emergency_stop: state.flags & FLAG_EMERGENCY_STOP != 0,
            shutting_down: state.flags & FLAG_SHUTDOWN != 0,
            battery_v: numbers(|joint| joint.supply_voltage).min_by(f32::total_cmp),
            hottest_celsius: numbers(|joint| joint.temperature).max_by(f32::total_cmp),
            motors: state.joints().len(),
            offline: named(|joint| joint.mode == MotorMode::Offline.code()),
            faulty: named(|joint| joint.fault != 0),
            groups: groups.map(|(group, state)| GroupSummary::of(&group.name, state, description)).collect(),
        }
    }

    /// Returns `true` for a robot without a stop, a silent motor or a fault.
    pub(crate) fn is_well(&self) -> bool {
        let is_stopped = self.groups.iter().any(|group| group.cause.is_some());
        !self.emergency_stop && !is_stopped && self.offline.is_empty() && self.faulty.is_empty()
    }
}

impl GroupSummary {
    fn of(name: &str, state: &GroupState, description: &RobotDescription) -> Self {
        let cause = Cause::try_from(state.cause).ok();
        let joint = description.joints.get(state.cause_joint as usize);
        let joint = joint.filter(|_| state.cause_joint != NO_JOINT && state.cause != 0);
        Self {
            name: name.to_owned(),
            phase: Phase::try_from(state.phase).map_or("unknown", Phase::name).to_owned(),
            owned: state.lease != 0,
            // A newer daemon may have causes that this program does not know.
            cause: (state.cause != 0).then(|| cause.map_or("unknown", Cause::name).to_owned()),
            joint: joint.map(|joint| joint.name.clone()),
            advice: cause.map(|cause| cause.advice().to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_shared::description::{GroupDescription, JointDescription};

    fn description() -> RobotDescription {
        let joint = |name: &str| JointDescription { name: name.to_owned(), ..Default::default() };
        RobotDescription {
            joints: ["hip", "knee"].map(joint).into(),
            groups: vec![GroupDescription { name: "leg".to_owned(), joints: vec![0, 1] }],
            ..Default::default()
        }
    }

    fn state() -> StateMessage {
        let mut state = StateMessage { joint_count: 2, group_count: 1, ..Default::default() };
        let joint =
            JointState { mode: MotorMode::Idle.code(), supply_voltage: f32::NAN, ..Default::default() };
        state.joints[..2].fill(joint);
        state
    }

    #[test]
    fn robot_at_rest_is_well() {
        let summary = Summary::of("go7", &description(), &state());
        assert!(summary.is_well() && summary.battery_v.is_none());
        assert_eq!(summary.groups[0].phase, "disarmed");
    }

    #[test]
    fn summary_names_what_is_wrong() {
        let mut state = state();
        state.groups[0].cause = Cause::MotorLost.code();
        state.groups[0].cause_joint = 1;
        (state.joints[0].mode, state.joints[1].fault) = (MotorMode::Offline.code(), 2);
        (state.joints[0].supply_voltage, state.joints[1].supply_voltage) = (24.0, 23.5);
        let summary = Summary::of("go7", &description(), &state);
        assert!(!summary.is_well());
        assert_eq!((summary.offline, summary.faulty), (vec!["hip".to_owned()], vec!["knee".to_owned()]));
        assert_eq!(summary.groups[0].joint.as_deref(), Some("knee"));
        assert_eq!((summary.groups[0].cause.as_deref(), summary.battery_v), (Some("motor-lost"), Some(23.5)));
    }

    #[test]
    fn hostile_numbers_are_unknown() {
        let mut state = state();
        state.groups[0] = GroupState { phase: 77, cause: 99, cause_joint: 50, ..Default::default() };
        let summary = Summary::of("go7", &description(), &state);
        assert_eq!((summary.groups[0].phase.as_str(), summary.groups[0].joint.is_none()), ("unknown", true));
        assert_eq!(summary.groups[0].cause.as_deref(), Some("unknown"));
    }
}
