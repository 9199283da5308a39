//! `/joy`: the sticks and buttons of the gamepad, as `sensor_msgs/Joy`.

use crate::controls::{AXES, Button, Values};
use crate::ros2::bounded::Bounded;
use crate::ros2::messages::{Header, Typed};
use crate::ros2::publish::{publisher, send};
use crate::ros2::stamp::header;
use crate::shared::Shared;
use ros2_client::Message;
use ros2_client::dds::{Node, Publisher};
use ros2_client::qos::{History, QosProfile};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Longest time between two messages: a subscription notices a dead bridge.
const SILENCE: Duration = Duration::from_millis(100);
/// Shortest time between two messages.
const PERIOD: Duration = Duration::from_millis(5);

/// The message.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Joy {
    header: Header,
    axes: Bounded<f32, { AXES.len() }>,
    buttons: Bounded<i32, { Button::ALL.len() }>,
}

impl Message for Joy {}

impl Typed for Joy {
    const TYPE: (&'static str, &'static str) = ("sensor_msgs", "Joy");
}

impl From<&Values> for Joy {
    fn from(values: &Values) -> Self {
        Self {
            header: header(Duration::ZERO, ""),
            axes: Bounded(values.axes.to_vec()),
            buttons: Bounded(values.buttons.map(i32::from).to_vec()),
        }
    }
}

/// Creates the topic. Best effort: a late value is worth less than the next one.
pub(crate) fn topic(node: &mut Node) -> Result<Publisher<Joy>, String> {
    let qos =
        QosProfile::publisher_default().reliability_best_effort().history(History::KeepLast { depth: 1 });
    publisher(node, "/joy", &qos)
}

/// Publishes the values at each change, and at least ten times a second, until the bridge ends.
pub(crate) fn run(topic: &Publisher<Joy>, shared: &Shared) {
    let mut values = Values::default();
    while !shared.ends() {
        values = shared.gamepad.wait(SILENCE).unwrap_or(values);
        send(topic, Joy::from(&values));
        std::thread::sleep(PERIOD);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unplugged_gamepad_is_published_as_released() {
        let joy = Joy::from(&Values::default());
        assert_eq!((joy.axes.0, joy.buttons.0), (vec![0.0; 8], vec![0; 13]));
    }

    #[test]
    fn pressed_button_is_one() {
        let values = Values::of("pad", |_| None, |code| code == Button::East.code());
        let pressed: Vec<usize> = Joy::from(&values)
            .buttons
            .0
            .iter()
            .enumerate()
            .filter(|(_, value)| **value == 1)
            .map(|(at, _)| at)
            .collect();
        assert_eq!(pressed, [Button::East as usize]);
    }
}
