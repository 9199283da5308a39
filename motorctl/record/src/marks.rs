//! The events that pictures and the monitor mark.

use motord_client::RobotDescription;
use motord_mcap::{Event, Level};

/// Returns whether an event is a stop or a fault of a joint or a group.
#[must_use]
pub fn is_mark(event: &Event) -> bool {
    // The emergency stop of the robot is an event of each group also.
    event.level == Level::Error && !event.subject.is_empty()
}

/// Returns whether an event is a stop or a fault of one of `joints` or of its group.
#[must_use]
pub fn concerns(event: &Event, robot: &RobotDescription, joints: &[usize]) -> bool {
    let name = |joint: &usize| robot.joints.get(*joint).map(|joint| &joint.name);
    let is_joint = || joints.iter().any(|joint| name(joint) == Some(&event.subject));
    let holds = |members: &[usize]| joints.iter().any(|joint| members.contains(joint));
    let is_group = || robot.groups.iter().any(|group| group.name == event.subject && holds(&group.joints));
    is_mark(event) && (is_joint() || is_group())
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_client::{GroupDescription, JointDescription};

    #[test]
    fn stops_and_faults_of_drawn_joints_are_marked() {
        let joint = |name: &str| JointDescription { name: name.to_owned(), ..JointDescription::default() };
        let group = |name: &str, joints| GroupDescription { name: name.to_owned(), joints };
        let robot = RobotDescription {
            joints: vec![joint("knee"), joint("elbow")],
            groups: vec![group("legs", vec![0]), group("arm", vec![1])],
            ..RobotDescription::default()
        };
        let event = |level, subject: &str| Event { level, subject: subject.to_owned(), text: String::new() };
        for (subject, is_drawn) in
            [("", false), ("knee", true), ("legs", true), ("elbow", false), ("arm", false)]
        {
            assert_eq!(concerns(&event(Level::Error, subject), &robot, &[0]), is_drawn, "{subject}");
        }
        assert!(!concerns(&event(Level::Info, "knee"), &robot, &[0]));
    }
}
