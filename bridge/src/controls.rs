//! The sticks and buttons of a gamepad, in an order that is the same for every gamepad.

use serde::ser::{SerializeStruct, Serializer};
use serde::{Deserialize, Serialize};

/// Names of the axes, in the order of [`Values::axes`].
pub(crate) const AXES: [&str; 8] =
    ["left-x", "left-y", "right-x", "right-y", "left-trigger", "right-trigger", "dpad-x", "dpad-y"];

/// Axes of the kernel: input-event-codes.h.
mod abs {
    pub(super) const X: u16 = 0x00;
    pub(super) const Y: u16 = 0x01;
    pub(super) const Z: u16 = 0x02;
    pub(super) const RX: u16 = 0x03;
    pub(super) const RY: u16 = 0x04;
    pub(super) const RZ: u16 = 0x05;
    pub(super) const GAS: u16 = 0x09;
    pub(super) const BRAKE: u16 = 0x0a;
    pub(super) const HAT0X: u16 = 0x10;
    pub(super) const HAT0Y: u16 = 0x11;
    pub(super) const HAT2X: u16 = 0x14;
    pub(super) const HAT2Y: u16 = 0x15;
}

/// Buttons of the kernel for up, down, left and right.
const DPAD: [u16; 4] = [0x220, 0x221, 0x222, 0x223];

/// A button by its position, as the kernel names it: `East` is B of an Xbox gamepad.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Button {
    South,
    East,
    North,
    West,
    Tl,
    Tr,
    Tl2,
    Tr2,
    Select,
    Start,
    Mode,
    Thumbl,
    Thumbr,
}

/// Each button with its name in the configuration and the kernel's code.
const BUTTONS: [(Button, &str, u16); 13] = [
    (Button::South, "south", 0x130),
    (Button::East, "east", 0x131),
    (Button::North, "north", 0x133),
    (Button::West, "west", 0x134),
    (Button::Tl, "tl", 0x136),
    (Button::Tr, "tr", 0x137),
    (Button::Tl2, "tl2", 0x138),
    (Button::Tr2, "tr2", 0x139),
    (Button::Select, "select", 0x13a),
    (Button::Start, "start", 0x13b),
    (Button::Mode, "mode", 0x13c),
    (Button::Thumbl, "thumbl", 0x13d),
    (Button::Thumbr, "thumbr", 0x13e),
];

impl Button {
    /// Every button, in the order of [`Values::buttons`].
    pub(crate) const ALL: [Self; BUTTONS.len()] = {
        let mut all = [Self::South; BUTTONS.len()];
        let mut index = 0;
        while index < all.len() {
            all[index] = BUTTONS[index].0;
            index += 1;
        }
        all
    };

    /// Returns its name in the configuration.
    pub(crate) fn name(self) -> &'static str {
        BUTTONS[self as usize].1
    }

    /// Returns the kernel's code.
    pub(crate) fn code(self) -> u16 {
        BUTTONS[self as usize].2
    }
}

/// An axis as the kernel reports it.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Axis {
    pub(crate) value: i32,
    pub(crate) minimum: i32,
    pub(crate) maximum: i32,
    /// Distance from the middle that counts as the middle.
    pub(crate) flat: i32,
}

impl Axis {
    fn is_valid(self) -> bool {
        self.minimum < self.maximum && (self.minimum..=self.maximum).contains(&self.value)
    }

    /// Returns -1 to 1 from end to end; 0 for a value out of the range.
    fn stick(self) -> f32 {
        let [value, minimum, maximum] = [self.value, self.minimum, self.maximum].map(f64::from);
        let (middle, half) = ((minimum + maximum) / 2.0, (maximum - minimum) / 2.0);
        let is_flat = (value - middle).abs() <= f64::from(self.flat);
        if self.is_valid() && !is_flat { ((value - middle) / half) as f32 } else { 0.0 }
    }

    /// Returns 0 to 1 from end to end; 0 for a value out of the range.
    fn trigger(self) -> f32 {
        let [value, minimum, maximum] = [self.value, self.minimum, self.maximum].map(f64::from);
        if self.is_valid() { ((value - minimum) / (maximum - minimum)) as f32 } else { 0.0 }
    }
}

/// The present values. A missing axis is 0, a missing button released.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Values {
    /// Name of the gamepad; `None` without one.
    pub(crate) name: Option<String>,
    /// Left and up are positive, as forward and left of a robot in ROS. Sticks and direction pad from -1
    /// to 1, triggers from 0 to 1.
    pub(crate) axes: [f32; AXES.len()],
    /// `true` while pressed.
    pub(crate) buttons: [bool; Button::ALL.len()],
}

impl Values {
    /// Returns the values of the gamepad `name`. `axis` returns those that it has, `is_pressed` is the
    /// state of a code.
    pub(crate) fn of(
        name: &str,
        axis: impl Fn(u16) -> Option<Axis>,
        is_pressed: impl Fn(u16) -> bool,
    ) -> Self {
        let stick = |code| axis(code).map_or(0.0, Axis::stick);
        let first = |codes: &[u16]| codes.iter().find_map(|code| axis(*code)).map_or(0.0, Axis::trigger);
        let pad = |more: u16, less: u16| f32::from(is_pressed(more)) - f32::from(is_pressed(less));
        let has_right = axis(abs::RX).is_some();
        let [right_x, right_y] = if has_right { [abs::RX, abs::RY] } else { [abs::Z, abs::RZ] };
        let [left_trigger, right_trigger] = match has_right {
            true => [first(&[abs::Z, abs::BRAKE, abs::HAT2Y]), first(&[abs::RZ, abs::GAS, abs::HAT2X])],
            false => [first(&[abs::BRAKE, abs::HAT2Y]), first(&[abs::GAS, abs::HAT2X])],
        };
        let [up, down, left, right] = DPAD;
        let axes = [
            // Not the negative, which makes -0 of 0.
            0.0 - stick(abs::X),
            0.0 - stick(abs::Y),
            0.0 - stick(right_x),
            0.0 - stick(right_y),
            left_trigger,
            right_trigger,
            (pad(left, right) - stick(abs::HAT0X)).clamp(-1.0, 1.0),
            (pad(up, down) - stick(abs::HAT0Y)).clamp(-1.0, 1.0),
        ];
        let buttons = Button::ALL.map(|button| is_pressed(button.code()));
        Self { name: Some(name.to_owned()), axes, buttons }
    }

    pub(crate) fn is_pressed(&self, button: Button) -> bool {
        self.buttons[button as usize]
    }
}

/// Names, each with its value.
struct Named<I>(I);

impl<I: Iterator<Item = (&'static str, V)> + Clone, V: Serialize> Serialize for Named<I> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.clone())
    }
}

impl Serialize for Values {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut values = serializer.serialize_struct("gamepad", 4)?;
        values.serialize_field("connected", &self.name.is_some())?;
        values.serialize_field("name", &self.name)?;
        values.serialize_field("axes", &Named(AXES.into_iter().zip(self.axes)))?;
        let names = Button::ALL.into_iter().map(Button::name);
        values.serialize_field("buttons", &Named(names.zip(self.buttons)))?;
        values.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STICK: Axis = Axis { value: 0, minimum: -32768, maximum: 32767, flat: 128 };

    fn stick(value: i32) -> Axis {
        Axis { value, ..STICK }
    }

    fn axes(found: &[(u16, Axis)]) -> [f32; AXES.len()] {
        let axis = |code| found.iter().find(|(known, _)| *known == code).map(|(_, axis)| *axis);
        Values::of("pad", axis, |_| false).axes
    }

    #[test]
    fn left_and_up_are_positive() {
        let pushed = axes(&[(abs::X, stick(-32768)), (abs::Y, stick(-32768)), (abs::HAT0X, stick(32767))]);
        assert_eq!(pushed, [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0]);
    }

    #[test]
    fn value_out_of_range_counts_as_released() {
        for value in [i32::MIN, -32769, 32768, i32::MAX] {
            assert_eq!(axes(&[(abs::X, stick(value)), (abs::RX, STICK), (abs::Z, stick(value))]), [0.0; 8]);
        }
        let reversed = Axis { minimum: 1, maximum: -1, ..STICK };
        let empty = Axis { minimum: 0, maximum: 0, ..STICK };
        assert_eq!(axes(&[(abs::X, reversed), (abs::Y, empty)]), [0.0; 8]);
    }

    #[test]
    fn any_value_stays_within_its_bounds() {
        for value in [i32::MIN, -1, 0, 1, i32::MAX] {
            for (minimum, maximum) in [(i32::MIN, i32::MAX), (-1, 1), (0, 1), (i32::MAX, i32::MIN)] {
                for flat in [i32::MIN, 0, i32::MAX] {
                    let axis = Axis { value, minimum, maximum, flat };
                    assert!((-1.0..=1.0).contains(&axis.stick()) && (0.0..=1.0).contains(&axis.trigger()));
                }
            }
        }
    }

    #[test]
    fn middle_within_flat_is_zero() {
        assert_eq!(stick(100).stick(), 0.0);
        assert!(stick(200).stick() > 0.0);
    }

    #[test]
    fn both_layouts_of_right_stick_and_triggers() {
        let pulled = Axis { value: 255, minimum: 0, maximum: 255, flat: 0 };
        let xbox = axes(&[(abs::RX, stick(-32768)), (abs::RY, STICK), (abs::Z, pulled)]);
        assert_eq!(xbox, [0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        let other = axes(&[(abs::Z, stick(-32768)), (abs::RZ, STICK), (abs::GAS, pulled)]);
        assert_eq!(other, [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    }

    #[test]
    fn direction_pad_of_buttons_is_an_axis() {
        let values = Values::of("pad", |_| None, |code| code == DPAD[0] || code == DPAD[3]);
        assert_eq!(values.axes[6..], [-1.0, 1.0]);
    }

    #[test]
    fn button_has_index_code_and_name() {
        for (index, button) in Button::ALL.into_iter().enumerate() {
            let values = Values::of("pad", |_| None, |code| code == button.code());
            assert!(values.is_pressed(button) && values.buttons[index]);
            assert_eq!(values.buttons.iter().filter(|pressed| **pressed).count(), 1);
            assert_eq!(
                toml::from_str::<One>(&format!("button = {:?}", button.name())).unwrap().button,
                button
            );
        }
    }

    #[derive(Deserialize)]
    struct One {
        button: Button,
    }

    #[test]
    fn json_names_each_value() {
        let json: serde_json::Value = serde_json::to_value(Values::default()).unwrap();
        assert_eq!((&json["connected"], &json["name"]), (&false.into(), &serde_json::Value::Null));
        assert_eq!((&json["axes"]["left-x"], &json["buttons"]["east"]), (&0.0.into(), &false.into()));
    }
}
