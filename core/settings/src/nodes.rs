//! The motors and sensors of a bus, for its transport.

use crate::settings::{MotorSettings, Settings};
use motord_bus::Duration;
use motord_bus::transport::{Node, Nodes};

/// Returns the nodes of the bus with this index. A request on a line without an answer is given up
/// after `reply_timeout`. Allocates.
#[must_use]
pub fn nodes(settings: &Settings, bus: usize, reply_timeout: Duration) -> Nodes {
    let motors = || settings.motors.iter().filter(move |motor| motor.bus == bus);
    let sensors = || settings.sensors.on_bus(bus);
    let node = |motor: &MotorSettings| Node {
        command_id: motor.command_id(),
        host_id: motor.host_id,
        commands: motor.addresses().commands,
        replies: motor.addresses().replies,
    };
    // The motors of a line are of one family.
    let answers = motors().find_map(|motor| motor.protocol.family().answers_on_line);
    Nodes {
        motors: motors().map(node).collect(),
        sensor_ids: sensors().flat_map(|sensor| sensor.sent_ids).collect(),
        requests: sensors().map(|sensor| sensor.requests.len() as u32).sum(),
        reply_timeout,
        answers: answers.unwrap_or(|_, _| false),
    }
}
