//! The channels: those of a recording, and `/joint_states` and `/latencies` beside them.

use foxglove::messages::{JointState, JointStates, Timestamp};
use foxglove::{Channel, Context, PartialMetadata, RawChannel, Schema, SinkId};
use motord_client::{ControlLatency, Percentiles, RobotDescription, State, Telemetry, named_telemetry};
use motord_mcap::{Event, SCHEMA, Topic};
use serde_json::{Value, json};
use std::sync::Arc;

/// The topic with the description of the robot.
pub(crate) const ROBOT: &str = "/robot";

/// All channels.
pub(crate) struct Channels {
    context: Arc<Context>,
    topics: Vec<(Topic, Arc<RawChannel>)>,
    events: Arc<RawChannel>,
    joint_states: Channel<JointStates>,
    latencies: Arc<RawChannel>,
    robot: Arc<RawChannel>,
    /// The only message of `/robot`.
    description: Vec<u8>,
}

impl Channels {
    /// Creates the channels of `robot`.
    pub(crate) fn new(robot: &RobotDescription) -> Result<Self, String> {
        let context = Context::new();
        let channel = |name: &str, encoding: &str, schema: Schema| {
            let channel = context.channel_builder(name).message_encoding(encoding).schema(schema);
            channel.build_raw().map_err(|error| format!("cannot create the channel {name}: {error}"))
        };
        let protobuf = |topic: Topic| {
            let name = topic.name(robot).unwrap_or_default();
            channel(&name, "protobuf", Schema::new(topic.schema(), "protobuf", SCHEMA))
        };
        let topics = Topic::all(robot).into_iter().filter(|topic| *topic != Topic::Events);
        let topics = topics.map(|topic| Ok((topic, protobuf(topic)?)));
        let topics = topics.collect::<Result<Vec<_>, String>>()?;
        let events = protobuf(Topic::Events)?;
        let description = serde_json::to_value(robot).map_err(|error| error.to_string())?;
        Ok(Self {
            topics,
            events,
            joint_states: context.channel_builder("/joint_states").build(),
            latencies: channel("/latencies", "json", json_schema("motord.Latencies", &latencies(robot)))?,
            robot: channel(ROBOT, "json", json_schema("motord.Robot", &description))?,
            description: description.to_string().into_bytes(),
            context,
        })
    }

    pub(crate) fn context(&self) -> &Arc<Context> {
        &self.context
    }

    /// Sends the message of `topic`, if a viewer subscribes. Never waits.
    pub(crate) fn send(
        &self,
        is_due: impl Fn(Topic) -> bool,
        state: &State,
        robot: &RobotDescription,
        unix_ns: u64,
    ) {
        let due = self.topics.iter().filter(|(topic, channel)| is_due(*topic) && channel.has_sinks());
        for (topic, channel) in due {
            if let Some(message) = topic.encode(state.message(), robot) {
                channel.log_with_meta(&message, PartialMetadata::with_log_time(unix_ns));
            }
        }
    }

    /// Sends the joints for the 3D panel.
    pub(crate) fn send_joint_states(&self, state: &State, robot: &RobotDescription, unix_ns: u64) {
        if self.joint_states.has_sinks() {
            let message = joint_states(state, robot, unix_ns);
            self.joint_states.log_with_meta(&message, PartialMetadata::with_log_time(unix_ns));
        }
    }

    pub(crate) fn send_event(&self, event: &Event, unix_ns: u64) {
        let time = PartialMetadata::with_log_time(unix_ns);
        self.events.log_with_meta(&event.encode(unix_ns), time);
    }

    /// Returns `true` if a viewer subscribes to the latencies, which the daemon must be asked for.
    pub(crate) fn wants_latencies(&self) -> bool {
        self.latencies.has_sinks()
    }

    pub(crate) fn send_latencies(&self, robot: &RobotDescription, telemetry: &Telemetry) {
        if let Ok(message) = serde_json::to_vec(&named_telemetry(robot, telemetry)) {
            self.latencies.log(&message);
        }
    }

    /// Sends the description of the robot to one viewer.
    pub(crate) fn send_description(&self, viewer: SinkId) {
        self.robot.log_to_sink(&self.description, Some(viewer));
    }
}

/// Returns the joints that have reported a position.
fn joint_states(state: &State, robot: &RobotDescription, unix_ns: u64) -> JointStates {
    let joints = robot.joints.iter().zip(state.joints()).filter_map(|(description, joint)| {
        Some(JointState {
            name: description.name.clone(),
            position: Some(joint.position()?.into()),
            velocity: joint.velocity().map(f64::from),
            acceleration: None,
            effort: joint.torque().map(f64::from),
        })
    });
    let seconds = u32::try_from(unix_ns / 1_000_000_000).unwrap_or(u32::MAX);
    let timestamp = Timestamp::new(seconds, (unix_ns % 1_000_000_000) as u32);
    JointStates { timestamp: Some(timestamp), joints: joints.collect() }
}

/// Returns a message of `/latencies` without values.
fn latencies(robot: &RobotDescription) -> Value {
    let telemetry = Telemetry {
        joints: vec![Percentiles::default(); robot.joints.len()],
        imus: vec![Percentiles::default(); robot.imus.len()],
        control: vec![ControlLatency { cycles: vec![0], ..Default::default() }; robot.groups.len()],
        ..Telemetry::default()
    };
    json!(named_telemetry(robot, &telemetry))
}

/// Returns the schema of messages like `sample`.
pub(crate) fn json_schema(name: &str, sample: &Value) -> Schema {
    Schema::new(name, "jsonschema", schema_of(sample).to_string().into_bytes())
}

fn schema_of(sample: &Value) -> Value {
    match sample {
        Value::Null => json!({}),
        Value::Bool(_) => json!({ "type": "boolean" }),
        Value::Number(_) => json!({ "type": "number" }),
        Value::String(_) => json!({ "type": "string" }),
        Value::Array(items) => match items.first() {
            Some(item) => json!({ "type": "array", "items": schema_of(item) }),
            None => json!({ "type": "array" }),
        },
        Value::Object(members) => {
            let properties: serde_json::Map<_, _> =
                members.iter().map(|(name, value)| (name.clone(), schema_of(value))).collect();
            json!({ "type": "object", "properties": properties })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_client::{JointDescription, StateMessage};

    fn robot(names: &[&str]) -> RobotDescription {
        let joint = |name: &&str| JointDescription { name: (*name).to_owned(), ..Default::default() };
        RobotDescription { joints: names.iter().map(joint).collect(), ..Default::default() }
    }

    #[test]
    fn joint_without_reply_has_no_joint_state() {
        let mut message = StateMessage { joint_count: 2, ..StateMessage::default() };
        message.joints[1].flags = u32::MAX;
        (message.joints[1].position, message.joints[1].torque) = (0.5, f32::NAN);
        let states = joint_states(&State::from(&message), &robot(&["hip", "knee"]), 3_000_000_007);
        assert_eq!(states.timestamp, Some(Timestamp::new(3, 7)));
        let [knee] = &states.joints[..] else { panic!("{states:?}") };
        assert_eq!((knee.name.as_str(), knee.position, knee.effort), ("knee", Some(0.5), None));
    }

    #[test]
    fn joints_missing_in_the_state_are_left_out() {
        let empty = State::from(&StateMessage::default());
        assert!(joint_states(&empty, &robot(&["hip", "knee"]), u64::MAX).joints.is_empty());
    }

    #[test]
    fn schema_has_the_members_of_the_sample() {
        let schema = schema_of(&json!({ "a": [{ "b": 1.5 }], "c": "text", "d": true, "e": [] }));
        let items = json!({ "type": "object", "properties": { "b": { "type": "number" } } });
        let expected = json!({ "type": "object", "properties": {
            "a": { "type": "array", "items": items },
            "c": { "type": "string" },
            "d": { "type": "boolean" },
            "e": { "type": "array" },
        } });
        assert_eq!(schema, expected);
    }
}
