//! The thread that publishes states. It takes the newest one and never delays the motor thread.

use crate::config::Ros2;
use crate::pace::Pace;
use crate::ros2::bounded::Bounded;
use crate::ros2::diagnostics;
use crate::ros2::messages::{DiagnosticArray, GroupState, Imu, JointState, Quaternion, Text, Typed, Vector3};
use crate::ros2::names::topic_part;
use crate::ros2::stamp::header;
use crate::shared::{Report, Shared, Snapshot};
use crate::urdf;
use motord_client::{Joint, State};
use ros2_client::dds::{Node, Publisher};
use ros2_client::qos::{Durability, History, QosProfile, WhenFull};
use ros2_client::{Message, Name};
use serde::Serialize;
use std::time::{Duration, Instant};

/// Longest wait for a state. Diagnostics are also published without one.
const WAIT: Duration = Duration::from_millis(100);

/// Longest time between two diagnostics.
const DIAGNOSTICS_PERIOD_MAX: Duration = Duration::from_secs(3600);

/// Returns the number of cycles after which the fastest topic needs a state.
pub(crate) fn cycles_between_states(ros2: &Ros2, cycle_hz: f64) -> u32 {
    let fastest = ros2.joint_states_hz.max(ros2.imu_hz).max(ros2.group_states_hz);
    let cycles = Pace::new(fastest, cycle_hz).cycles;
    // Without a topic, once in a while, for the diagnostics.
    u32::try_from(cycles).ok().filter(|cycles| *cycles > 0).unwrap_or(100)
}

/// A group's publisher and pace.
struct GroupTopic {
    index: usize,
    publisher: Publisher<GroupState>,
}

/// The topics.
pub(crate) struct States {
    joints: Publisher<JointState>,
    imus: Vec<Publisher<Imu>>,
    groups: Vec<GroupTopic>,
    diagnostics: Publisher<DiagnosticArray>,
    /// Kept for later subscriptions.
    _description: Option<Publisher<Text>>,
    ros2: Ros2,
    cycle_hz: f64,
}

/// Creates a publisher of `name`.
pub(crate) fn publisher<M: Typed + Message>(
    node: &mut Node,
    name: &str,
    qos: &QosProfile,
) -> Result<Publisher<M>, String> {
    let failed = |error: &dyn std::fmt::Display| format!("cannot create the topic {name}: {error}");
    let topic = Name::parse(name).map_err(|error| failed(&format!("{error:?}")))?;
    let topic = node.create_topic(&topic, M::type_name(), qos).map_err(|error| failed(&error))?;
    node.create_publisher(&topic, None).map_err(|error| failed(&error))
}

/// Returns the QoS of states. A publisher never waits for a slow subscription.
fn qos(ros2: &Ros2) -> QosProfile {
    let qos = QosProfile::publisher_default().history(History::KeepLast { depth: 10 });
    match ros2.reliable_states {
        true => qos.reliability_reliable(WhenFull::Fail),
        false => qos.reliability_best_effort(),
    }
}

impl States {
    /// Creates the topics, and publishes the robot description. `topics` are the names of the groups in topics.
    pub(crate) fn new(
        node: &mut Node,
        ros2: &Ros2,
        shared: &Shared,
        topics: &[String],
    ) -> Result<Self, String> {
        let qos = qos(ros2);
        let robot = &shared.robot;
        let imu_topic = |index: usize| match robot.imus.len() {
            1 => "/imu/data".to_owned(),
            _ => format!("/imu/{}/data", topic_part(&robot.imus[index].name)),
        };
        let imus = (0..robot.imus.len()).map(|index| publisher(node, &imu_topic(index), &qos));
        let imus = imus.collect::<Result<_, _>>()?;
        let mut groups = Vec::new();
        for (index, topic) in topics.iter().enumerate() {
            let publisher = publisher(node, &format!("/motord/{topic}/state"), &qos)?;
            groups.push(GroupTopic { index, publisher });
        }
        let reliable = qos.clone().reliability_reliable(WhenFull::Fail);
        Ok(Self {
            joints: publisher(node, "/joint_states", &qos)?,
            imus,
            groups,
            diagnostics: publisher(node, "/diagnostics", &reliable)?,
            _description: description(node, ros2)?,
            ros2: ros2.clone(),
            cycle_hz: robot.rate_hz,
        })
    }

    /// Publishes until the bridge ends.
    pub(crate) fn run(self, shared: &Shared) {
        let pace = |hz| Pace::new(hz, self.cycle_hz);
        let (mut joints, mut imus) = (pace(self.ros2.joint_states_hz), pace(self.ros2.imu_hz));
        let mut groups = pace(self.ros2.group_states_hz);
        let diagnostics_hz = self.ros2.diagnostics_hz;
        let period = Duration::try_from_secs_f64(1.0 / diagnostics_hz).unwrap_or(Duration::MAX);
        let period = (diagnostics_hz > 0.0).then(|| period.min(DIAGNOSTICS_PERIOD_MAX));
        let mut next = Instant::now();
        while !shared.ends() {
            let report = shared.report.wait(WAIT);
            if let Some(Report::State(snapshot)) = &report {
                let cycle = snapshot.state.cycle();
                if joints.is_due(cycle) {
                    send(&self.joints, joint_state(snapshot));
                }
                if imus.is_due(cycle) {
                    self.send_imus(&snapshot.state);
                }
                if groups.is_due(cycle) {
                    self.send_groups(snapshot, shared);
                }
            }
            // Without a report nothing new is known: the next one is at most a wait away.
            if let Some((report, period)) = report.zip(period).filter(|_| Instant::now() >= next) {
                next = Instant::now() + period;
                send(&self.diagnostics, diagnostics::array(&report, shared));
            }
        }
    }

    fn send_imus(&self, state: &State) {
        for (publisher, imu) in self.imus.iter().zip(state.imus()) {
            if let Some(message) = imu_message(&imu, &self.ros2.imu_frame) {
                send(publisher, message);
            }
        }
    }

    fn send_groups(&self, snapshot: &Snapshot, shared: &Shared) {
        for topic in &self.groups {
            if let Some(message) = group_state(snapshot, shared, topic.index) {
                send(&topic.publisher, message);
            }
        }
    }
}

/// A message that does not fit into the window of a slow subscription is dropped.
pub(crate) fn send<M: Serialize>(publisher: &Publisher<M>, message: M) {
    if let Err(error) = publisher.publish(message) {
        log::debug!("a message was dropped: {error}");
    }
}

fn description(node: &mut Node, ros2: &Ros2) -> Result<Option<Publisher<Text>>, String> {
    let Some(path) = &ros2.robot_description else { return Ok(None) };
    let data = urdf::read(path)?;
    let latched = QosProfile::publisher_default()
        .reliability_reliable(WhenFull::Fail)
        .durability(Durability::TransientLocal)
        .history(History::KeepLast { depth: 1 });
    let publisher = publisher::<Text>(node, "/robot_description", &latched)?;
    publisher.publish(Text { data }).map_err(|error| format!("/robot_description: {error}"))?;
    Ok(Some(publisher))
}

/// The joints that have reported a position.
fn joint_state(snapshot: &Snapshot) -> JointState {
    let Snapshot { state, robot } = snapshot;
    let known: Vec<_> =
        robot.joints.iter().zip(state.joints()).filter(|(_, joint)| joint.position().is_some()).collect();
    let numbers = |value: fn(&Joint) -> Option<f32>| {
        Bounded(known.iter().map(|(_, joint)| number(value(joint))).collect())
    };
    JointState {
        header: header(state.age(), ""),
        name: Bounded(known.iter().map(|(joint, _)| joint.name.clone()).collect()),
        position: numbers(Joint::position),
        velocity: numbers(Joint::velocity),
        effort: numbers(Joint::torque),
    }
}

/// Returns NaN for an unknown value.
fn number(value: Option<f32>) -> f64 {
    value.map_or(f64::NAN, f64::from)
}

/// `None` before the first sample, and while the IMU is lost.
fn imu_message(imu: &motord_client::Imu, frame: &str) -> Option<Imu> {
    if imu.lost {
        return None;
    }
    let [x, y, z] = imu.angular_velocity()?.map(f64::from);
    let [ax, ay, az] = imu.acceleration()?.map(f64::from);
    // By the definition of the message: all zeros are an unknown covariance, a first number of -1 is an unknown value.
    let (unknown, mut no_orientation) = ([0.0; 9], [0.0; 9]);
    no_orientation[0] = -1.0;
    let orientation = imu.orientation().map(|turn| turn.map(f64::from));
    let [w, i, j, k] = orientation.unwrap_or([1.0, 0.0, 0.0, 0.0]);
    Some(Imu {
        header: header(imu.age()?, frame),
        orientation: Quaternion { x: i, y: j, z: k, w },
        orientation_covariance: if orientation.is_some() { unknown } else { no_orientation },
        angular_velocity: Vector3 { x, y, z },
        angular_velocity_covariance: unknown,
        linear_acceleration: Vector3 { x: ax, y: ay, z: az },
        linear_acceleration_covariance: unknown,
    })
}

fn group_state(snapshot: &Snapshot, shared: &Shared, index: usize) -> Option<GroupState> {
    let state = &snapshot.state;
    let (link, group) = (shared.groups.get(index)?, state.group(index)?);
    let joints: Vec<_> = link.group.joints.iter().map(|joint| state.joint(joint.index)).collect();
    let numbers = |value: fn(&Joint) -> Option<f32>| {
        joints.iter().map(|joint| number(joint.as_ref().and_then(value))).collect()
    };
    let age = state.age();
    Some(GroupState {
        header: header(age, ""),
        names: link.group.joints.iter().map(|joint| joint.name.clone()).collect(),
        position: numbers(Joint::position),
        velocity: numbers(Joint::velocity),
        effort: numbers(Joint::torque),
        phase: group.phase.map_or_else(String::new, |phase| phase.name().to_owned()),
        latched: group.latched,
        cause: group.cause.map_or_else(String::new, |cause| cause.name().to_owned()),
        cycle: state.cycle(),
        age: age.as_secs_f64(),
        claimed: link.gate.claim().is_some(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_of_zero_publishes_nothing() {
        let mut pace = Pace::new(0.0, 1000.0);
        assert!(!(0..100).any(|cycle| pace.is_due(cycle)));
        let ros2 = Ros2 { joint_states_hz: 0.0, imu_hz: 0.0, group_states_hz: 250.0, ..Ros2::default() };
        assert_eq!(cycles_between_states(&ros2, 1000.0), 4);
    }
}
