//! The topics of a recording, and the message of a state on each, also for programs that send
//! them elsewhere than to a file.

use crate::encode;
use crate::events::Event;
use motord_shared::StateMessage;
use motord_shared::description::RobotDescription;
use prost::Message;

/// A topic. Its number is the index in the robot's description.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Topic {
    /// `/joints/NAME`.
    Joint(usize),
    /// `/groups/NAME`.
    Group(usize),
    /// `/buses/NAME`.
    Bus(usize),
    /// `/indicators/NAME`, of the joint with this index.
    Indicators(usize),
    /// `/imus/NAME`.
    Imu(usize),
    /// `/cycle`.
    Cycle,
    /// `/events`; see [`Event::encode`].
    Events,
}

impl Topic {
    /// Returns the topics of `robot`.
    #[must_use]
    pub fn all(robot: &RobotDescription) -> Vec<Self> {
        let mut topics: Vec<Self> = (0..robot.joints.len()).map(Self::Joint).collect();
        topics.extend((0..robot.groups.len()).map(Self::Group));
        topics.extend((0..robot.buses.len()).map(Self::Bus));
        topics.extend((0..robot.joints.len()).map(Self::Indicators));
        topics.extend((0..robot.imus.len()).map(Self::Imu));
        topics.extend([Self::Cycle, Self::Events]);
        topics
    }

    /// Returns the name of the topic; `None` for an index that `robot` lacks.
    #[must_use]
    pub fn name(self, robot: &RobotDescription) -> Option<String> {
        Some(match self {
            Self::Joint(index) => format!("/joints/{}", robot.joints.get(index)?.name),
            Self::Group(index) => format!("/groups/{}", robot.groups.get(index)?.name),
            Self::Bus(index) => format!("/buses/{}", robot.buses.get(index)?),
            Self::Indicators(index) => format!("/indicators/{}", robot.joints.get(index)?.name),
            Self::Imu(index) => format!("/imus/{}", robot.imus.get(index)?.name),
            Self::Cycle => "/cycle".to_owned(),
            Self::Events => "/events".to_owned(),
        })
    }

    /// Returns the name of the message in [`SCHEMA`](crate::SCHEMA).
    #[must_use]
    pub fn schema(self) -> &'static str {
        match self {
            Self::Joint(_) => "motord.Joint",
            Self::Group(_) => "motord.Group",
            Self::Bus(_) => "motord.Bus",
            Self::Indicators(_) => "motord.Indicators",
            Self::Imu(_) => "motord.Imu",
            Self::Cycle => "motord.Cycle",
            Self::Events => "foxglove.Log",
        }
    }

    /// Encodes the message of `state`: without the setpoints and the sequence number, which only
    /// records of cycles have. `None` for events, and where the state lacks this part.
    #[must_use]
    pub fn encode(self, state: &StateMessage, robot: &RobotDescription) -> Option<Vec<u8>> {
        let cycle = state.cycle;
        Some(match self {
            Self::Joint(index) => encode::joint(cycle, state.joints().get(index)?, None).encode_to_vec(),
            Self::Group(index) => encode::group(cycle, state.groups().get(index)?, robot).encode_to_vec(),
            Self::Bus(index) => encode::bus(cycle, state.buses().get(index)?).encode_to_vec(),
            Self::Indicators(index) => {
                let mut published = state.indicators().iter();
                encode::indicators(published.find(|motor| motor.joint as usize == index)?).encode_to_vec()
            }
            Self::Imu(index) => encode::imu(cycle, state.imus().get(index)?).encode_to_vec(),
            Self::Cycle => encode::cycle(state, 0).encode_to_vec(),
            Self::Events => return None,
        })
    }
}

impl Event {
    /// Encodes the message of `/events`, at this Unix time, ns.
    #[must_use]
    pub fn encode(&self, unix_ns: u64) -> Vec<u8> {
        encode::log(self, unix_ns).encode_to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_shared::description::{GroupDescription, ImuDescription, JointDescription};

    #[test]
    fn every_topic_of_description_has_a_message() {
        let joint = JointDescription { name: "knee".into(), ..JointDescription::default() };
        let robot = RobotDescription {
            joints: vec![joint],
            groups: vec![GroupDescription { name: "legs".into(), joints: vec![0] }],
            imus: vec![ImuDescription { name: "base".into(), ..Default::default() }],
            buses: vec!["left".into()],
            ..Default::default()
        };
        let state = StateMessage {
            joint_count: 1,
            group_count: 1,
            bus_count: 1,
            imu_count: 1,
            ..StateMessage::default()
        };
        let topics = Topic::all(&robot);
        let names: Vec<_> = topics.iter().filter_map(|topic| topic.name(&robot)).collect();
        let expected = [
            "/joints/knee",
            "/groups/legs",
            "/buses/left",
            "/indicators/knee",
            "/imus/base",
            "/cycle",
            "/events",
        ];
        assert_eq!(names, expected);
        let silent: Vec<_> =
            topics.iter().filter(|topic| topic.encode(&state, &robot).is_none()).copied().collect();
        assert_eq!(silent, [Topic::Indicators(0), Topic::Events], "the motor has no indicators");
    }

    #[test]
    fn index_beyond_the_robot_is_no_topic() {
        let robot = RobotDescription::default();
        assert_eq!(Topic::Joint(0).name(&robot), None);
        assert_eq!(Topic::Bus(usize::MAX).encode(&StateMessage::default(), &robot), None);
    }
}
