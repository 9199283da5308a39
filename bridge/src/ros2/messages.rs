//! The messages of ROS 2 that the bridge exchanges, with the fields of their definitions.

use crate::ros2::bounded::Bounded;
use crate::rules::Stamp;
use ros2_client::{Message, MessageTypeName};
use serde::{Deserialize, Serialize};

/// Limit on the joints of a command: that of motord.
const JOINTS_MAX: usize = 64;
/// Limit on the points of a trajectory.
const POINTS_MAX: usize = 2000;
/// Limit on the dimensions of an array, which the bridge ignores.
const DIMENSIONS_MAX: usize = 8;

/// One number for each joint.
pub(crate) type Numbers = Bounded<f64, JOINTS_MAX>;
/// One name for each joint.
pub(crate) type Names = Bounded<String, JOINTS_MAX>;

macro_rules! messages {
    ($($(#[doc = $doc:literal])+ $package:literal $name:ident { $($field:ident: $type:ty,)+ })+) => {
        $(
            $(#[doc = $doc])+
            #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
            pub(crate) struct $name { $(pub(crate) $field: $type,)+ }

            impl Message for $name {}

            impl Typed for $name {
                const TYPE: (&'static str, &'static str) = ($package, stringify!($name));
            }
        )+
    };
}

/// A message with its type.
pub(crate) trait Typed {
    /// Package and name.
    const TYPE: (&'static str, &'static str);

    fn type_name() -> MessageTypeName {
        MessageTypeName::new(Self::TYPE.0, Self::TYPE.1)
    }
}

messages! {
    /// A time since 1970.
    "builtin_interfaces" Time { sec: i32, nanosec: u32, }
    /// A duration.
    "builtin_interfaces" Duration { sec: i32, nanosec: u32, }
    /// Time and frame of a message.
    "std_msgs" Header { stamp: Time, frame_id: String, }
    /// A message without content.
    "std_msgs" Empty { structure_needs_at_least_one_member: u8, }
    /// A dimension of an array.
    "std_msgs" MultiArrayDimension { label: String, size: u32, stride: u32, }
    /// The layout of an array.
    "std_msgs" MultiArrayLayout { dim: Bounded<MultiArrayDimension, DIMENSIONS_MAX>, data_offset: u32, }
    /// An array of numbers.
    "std_msgs" Float64MultiArray { layout: MultiArrayLayout, data: Numbers, }
    /// Joints: rad, rad/s, N·m.
    "sensor_msgs" JointState { header: Header, name: Names, position: Numbers, velocity: Numbers, effort: Numbers, }
    /// Turn of a body.
    "geometry_msgs" Quaternion { x: f64, y: f64, z: f64, w: f64, }
    /// A vector.
    "geometry_msgs" Vector3 { x: f64, y: f64, z: f64, }
    /// An IMU: rad/s and m/s².
    "sensor_msgs" Imu {
        header: Header,
        orientation: Quaternion,
        orientation_covariance: [f64; 9],
        angular_velocity: Vector3,
        angular_velocity_covariance: [f64; 9],
        linear_acceleration: Vector3,
        linear_acceleration_covariance: [f64; 9],
    }
    /// A value of a diagnostic status.
    "diagnostic_msgs" KeyValue { key: String, value: String, }
    /// The status of a component: 0 OK, 1 warning, 2 error, 3 stale.
    "diagnostic_msgs" DiagnosticStatus {
        level: u8, name: String, message: String, hardware_id: String, values: Vec<KeyValue>,
    }
    /// The status of all components.
    "diagnostic_msgs" DiagnosticArray { header: Header, status: Vec<DiagnosticStatus>, }
    /// A point of a trajectory.
    "trajectory_msgs" JointTrajectoryPoint {
        positions: Numbers, velocities: Numbers, accelerations: Numbers, effort: Numbers, time_from_start: Duration,
    }
    /// A trajectory.
    "trajectory_msgs" JointTrajectory {
        header: Header, joint_names: Names, points: Bounded<JointTrajectoryPoint, POINTS_MAX>,
    }
    /// A command with gains; `motord_msgs/msg/ImpedanceCommand.msg`.
    "motord_msgs" ImpedanceCommand {
        header: Header,
        names: Names,
        position: Numbers,
        velocity: Numbers,
        effort: Numbers,
        kp: Numbers,
        kd: Numbers,
        horizon: f64,
    }
    /// The state of a group; `motord_msgs/msg/GroupState.msg`.
    "motord_msgs" GroupState {
        header: Header,
        names: Vec<String>,
        position: Vec<f64>,
        velocity: Vec<f64>,
        effort: Vec<f64>,
        phase: String,
        latched: bool,
        cause: String,
        cycle: u64,
        age: f64,
        claimed: bool,
    }
}

/// `std_msgs/String`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Text {
    pub(crate) data: String,
}

impl Message for Text {}

impl Typed for Text {
    const TYPE: (&'static str, &'static str) = ("std_msgs", "String");
}

/// The answer of `std_srvs/Trigger`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct TriggerResponse {
    pub(crate) success: bool,
    pub(crate) message: String,
}

impl Message for TriggerResponse {}

impl Time {
    /// Returns the time `ns` since 1970.
    pub(crate) fn of_ns(ns: u64) -> Self {
        let sec = i32::try_from(ns / 1_000_000_000).unwrap_or(i32::MAX);
        Self { sec, nanosec: (ns % 1_000_000_000) as u32 }
    }
}

impl From<&Time> for Stamp {
    fn from(time: &Time) -> Self {
        Self { sec: time.sec, nanosec: time.nanosec }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ros2_client::dds::rustdds::RepresentationIdentifier;
    use ros2_client::dds::rustdds::serialization::{deserialize_from_cdr_with_rep_id, to_writer_with_rep_id};
    use serde::de::DeserializeOwned;

    /// Decodes each prefix of a message, and the message with each byte changed.
    fn survive<M: Serialize + DeserializeOwned>(message: &M) {
        let encoding = RepresentationIdentifier::CDR_LE;
        let mut bytes = Vec::new();
        to_writer_with_rep_id(&mut bytes, message, encoding).unwrap();
        assert!(deserialize_from_cdr_with_rep_id::<M>(&bytes, encoding).is_ok());
        for length in 0..bytes.len() {
            assert!(deserialize_from_cdr_with_rep_id::<M>(&bytes[..length], encoding).is_err());
            for value in [0, 1, 0x7f, 0x80, 0xff] {
                let mut changed = bytes.clone();
                changed[length] = value;
                let _any_outcome = deserialize_from_cdr_with_rep_id::<M>(&changed, encoding);
            }
        }
    }

    #[test]
    fn damaged_messages_are_errors_and_no_panics() {
        let header = Header { stamp: Time::of_ns(1), frame_id: "base_link".to_owned() };
        let (names, numbers) = (Bounded(vec!["a".to_owned(), "b".to_owned()]), Bounded(vec![1.0, 2.0]));
        survive(&JointState {
            header: header.clone(),
            name: names.clone(),
            position: numbers.clone(),
            velocity: numbers.clone(),
            effort: numbers.clone(),
        });
        let point = JointTrajectoryPoint {
            positions: numbers.clone(),
            velocities: numbers.clone(),
            accelerations: Bounded(Vec::new()),
            effort: numbers.clone(),
            time_from_start: Duration { sec: 1, nanosec: 2 },
        };
        survive(&JointTrajectory {
            header: header.clone(),
            joint_names: names.clone(),
            points: Bounded(vec![point]),
        });
        survive(&ImpedanceCommand {
            header,
            names,
            position: numbers.clone(),
            velocity: numbers.clone(),
            effort: numbers.clone(),
            kp: numbers.clone(),
            kd: numbers,
            horizon: 0.02,
        });
    }
}
