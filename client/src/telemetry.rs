//! Telemetry with names.

use motord_shared::description::{RobotDescription, Telemetry};
use serde::Serialize;
use serde_json::{Value, json};

/// Returns the object that `motorctl latency --json` prints: [`Telemetry`] with the names of the
/// joints, IMUs and groups, without their owners and stops.
#[must_use]
pub fn named_telemetry(robot: &RobotDescription, telemetry: &Telemetry) -> impl Serialize + use<> {
    let mut object = json!(telemetry);
    // `status` shows owners and stops.
    object.as_object_mut().and_then(|object| object.remove("groups"));
    object["instance"] = json!(robot.instance);
    let joints = robot.joints.iter().zip(&telemetry.joints);
    object["joints"] =
        joints.map(|(joint, latency)| json!({ "name": joint.name, "reply_latency_us": latency })).collect();
    let imus = robot.imus.iter().zip(&telemetry.imus);
    object["imus"] = imus.map(|(imu, age)| json!({ "name": imu.name, "age_us": age })).collect();
    let groups = robot.groups.iter().zip(&telemetry.control);
    let control = groups.map(|(group, latency)| {
        json!({ "name": group.name, "control_latency_us": latency.control_latency_us, "cycles": latency.cycles })
    });
    object["control"] = control.collect::<Value>();
    object
}
