//! Frames of ODrive's Pro, S1 and Micro with firmware 0.6, as a driver decodes them.
//!
//! Sources: `can_simple_messages.hpp` and `odrive_enums.h` of odriverobotics/ros_odrive for the values,
//! ODrive's DBC file of firmware 0.6.10 for the sender of each message. The id has the node in the upper
//! six bits and the command in the lower five. All values are those of the rotor.

use super::codec::{Codec, Ids, Meaning, Reported, Sender};
use super::ranges::Ranges;
use motord_bus::Frame;
use std::f64::consts::TAU;

/// Rotor turns per turn of the output shaft, for a motor whose configuration has no gear ratio: a drive
/// has none.
pub const GEAR_RATIO: f64 = 1.0;
/// Four bytes that a command does not use, or a value of zero.
const ZERO: [u8; 4] = [0; 4];

/// An axis whose commands and estimates are those of the rotor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RotorAxis {
    /// Rotor turns per turn of the output shaft.
    pub gear_ratio: f64,
}

impl RotorAxis {
    /// Returns the angle of the output shaft, rad, for turns of the rotor. The same factor
    /// converts a speed from turns/s to rad/s.
    fn at_output(self, turns: f64) -> f64 {
        turns * TAU / self.gear_ratio
    }
}

impl Codec for RotorAxis {
    fn sender(&self, frame: &Frame, ids: &Ids) -> Option<Sender> {
        Some(match command_of(frame, ids.motor)? {
            // Version, heartbeat, errors, answer to a setting, estimates, current, temperatures, supply,
            // torques and powers.
            0x00 | 0x01 | 0x03 | 0x05 | 0x09 | 0x14 | 0x15 | 0x17 | 0x1C | 0x1D => Sender::Motor,
            // The node id and the serial number.
            0x06 => Sender::Either,
            _ => Sender::Host,
        })
    }

    fn order(&self, frame: &Frame) -> Meaning {
        let (command, first, second) = parts(frame);
        let value = f64::from(f32::from_le_bytes(first));
        match (command, first, second) {
            (0x07, [1, 0, 0, 0], ZERO) => Meaning::Stop,
            (0x07, [8, 0, 0, 0], ZERO) => Meaning::Start,
            // Torque, velocity or position, each without a ramp or filter. The axis stays as it is.
            (0x0B, [1..=3, 0, 0, 0], [1, 0, 0, 0]) => Meaning::Mode,
            // Without feed-forward.
            (0x0C, _, ZERO) => Meaning::Position(self.at_output(value)),
            (0x0D, _, ZERO) => Meaning::Speed(self.at_output(value)),
            (0x0E, _, ZERO) => Meaning::Torque(value * self.gear_ratio),
            (0x18, ZERO, ZERO) => Meaning::ClearFault,
            (0x19, ZERO, ZERO) => Meaning::SetZero,
            (other, ..) => Meaning::Other(other),
        }
    }

    fn reported(&self, frame: &Frame, id: u8) -> Option<Reported> {
        match (command_of(frame, id)?, frame.payload()) {
            (0x09, &[a, b, c, d, e, f, g, h]) => {
                let turns = [[a, b, c, d], [e, f, g, h]].map(|bytes| f64::from(f32::from_le_bytes(bytes)));
                Some(Reported::State(turns.map(|turns| self.at_output(turns))))
            }
            _ => None,
        }
    }

    fn codes(&self) -> Option<Ranges> {
        None
    }
}

/// Returns the command of a frame from or to a node; `None` for any other frame.
fn command_of(frame: &Frame, node: u8) -> Option<u8> {
    let raw = frame.id().raw();
    let is_of_node = !frame.id().is_extended() && raw >> 5 == u32::from(node);
    is_of_node.then_some((raw & 0x1F) as u8)
}

/// Returns the command and both halves of the payload, filled with zeros.
///
/// # Panics
///
/// When the frame has not the form and the length of this command.
fn parts(frame: &Frame) -> (u8, [u8; 4], [u8; 4]) {
    assert!(!frame.id().is_extended() && frame.is_classic(), "I1: {frame:?} has another form");
    let command = (frame.id().raw() & 0x1F) as u8;
    let length = if command == 0x18 { 1 } else { 8 };
    assert_eq!(frame.payload().len(), length, "I1: {frame:?} has another length");
    let byte = |at| frame.payload().get(at).copied().unwrap_or(0);
    (command, [0, 1, 2, 3].map(byte), [4, 5, 6, 7].map(byte))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::Protocol;
    use crate::robot::Wiring;
    use motord_bus::FrameId;

    const AXIS: RotorAxis = RotorAxis { gear_ratio: 8.0 };

    fn frame(id: u16, payload: &[u8]) -> Frame {
        Frame::new(FrameId::new(id).unwrap(), payload).unwrap()
    }

    /// Returns a frame to node 5 with the first of these bytes.
    fn command(command: u16, bytes: u64) -> Frame {
        let length = if command == 0x18 { 1 } else { 8 };
        frame(0x0A0 | command, &bytes.to_be_bytes()[..length])
    }

    /// 0.25 is 0x3E800000, -2.0 is 0xC0000000, 1.5 is 0x3FC00000 (IEEE 754), low byte first.
    #[test]
    fn setpoint_is_that_of_the_output() {
        assert_eq!(AXIS.order(&command(0x0E, 0x0000_803E_0000_0000)), Meaning::Torque(2.0));
        let speed = AXIS.order(&command(0x0D, 0x0000_00C0_0000_0000));
        assert!(
            matches!(speed, Meaning::Speed(speed) if (speed + std::f64::consts::FRAC_PI_2).abs() < 1e-5),
            "{speed:?}"
        );
        let position = AXIS.order(&command(0x0C, 0x0000_C03F_0000_0000));
        assert!(matches!(position, Meaning::Position(at) if (at - 1.178_097).abs() < 1e-5), "{position:?}");
        for command in [command(0x0C, 0), command(0x0D, 0), command(0x0E, 0)] {
            AXIS.check(&command);
        }
    }

    #[test]
    fn only_a_cycles_commands_are_permitted() {
        for (number, bytes, meaning) in [
            (0x07, 0x0100_0000_0000_0000, Meaning::Stop),
            (0x07, 0x0800_0000_0000_0000, Meaning::Start),
            (0x0B, 0x0100_0000_0100_0000, Meaning::Mode),
            (0x0B, 0x0200_0000_0100_0000, Meaning::Mode),
            (0x0B, 0x0300_0000_0100_0000, Meaning::Mode),
            (0x18, 0, Meaning::ClearFault),
            (0x19, 0, Meaning::SetZero),
        ] {
            let frame = command(number, bytes);
            AXIS.check(&frame);
            assert_eq!(AXIS.order(&frame), meaning);
        }
        // Emergency stop, setting, node id, limits, restart, gains, boot loader; calibrations and an
        // unknown state; voltage, no input, ramp and filter; identification; a position that is not
        // zero; feed-forward of velocity and of torque.
        for (number, bytes) in [
            (0x02, 0),
            (0x04, 0),
            (0x06, 0),
            (0x0F, 0),
            (0x16, 0),
            (0x1A, 0),
            (0x1B, 0),
            (0x1F, 0),
            (0x07, 0x0300_0000_0000_0000),
            (0x07, 0x0400_0000_0000_0000),
            (0x07, 0x0801_0000_0000_0000),
            (0x0B, 0x0000_0000_0100_0000),
            (0x0B, 0x0100_0000_0000_0000),
            (0x0B, 0x0200_0000_0200_0000),
            (0x0B, 0x0300_0000_0300_0000),
            (0x18, 0x0100_0000_0000_0000),
            (0x19, 0x0000_803F_0000_0000),
            (0x0C, 0x0000_C03F_0100_0000),
            (0x0C, 0x0000_C03F_0000_FFFF),
            (0x0D, 0x0000_00C0_0000_803F),
        ] {
            let forbidden = std::panic::catch_unwind(|| AXIS.check(&command(number, bytes)));
            assert!(forbidden.is_err(), "{number:#x} {bytes:016X}");
        }
        for other in [frame(0x0B8, &[0; 8]), frame(0x0A7, &[1, 0, 0, 0])] {
            assert!(std::panic::catch_unwind(|| AXIS.check(&other)).is_err(), "{other:?}: another length");
        }
    }

    #[test]
    fn every_report_is_sent_by_the_motor() {
        let ids = Ids { motor: 5, reply: FrameId::from(0xA9) };
        let sender = |id| AXIS.sender(&frame(id, &[0; 8]), &ids);
        for number in 0..=0x1F {
            let expected = match number {
                0 | 1 | 3 | 5 | 9 | 20 | 21 | 23 | 28 | 29 => Sender::Motor,
                6 => Sender::Either,
                _ => Sender::Host,
            };
            assert_eq!(sender(0x0A0 + number), Some(expected), "{number:#x}");
        }
        assert_eq!([sender(0x089), sender(0x0C9)], [None; 2]);
    }

    /// -0.64 is 0xBF23D70A and 2.0 is 0x40000000.
    #[test]
    fn estimates_of_this_node_alone_are_read() {
        let reported = |id, payload: &[u8]| match AXIS.reported(&frame(id, payload), 5) {
            Some(Reported::State(state)) => Some(state),
            _ => None,
        };
        let payload = [0x0A, 0xD7, 0x23, 0xBF, 0, 0, 0, 0x40];
        let [position, velocity] = reported(0x0A9, &payload).unwrap();
        assert!((position + 0.502_655).abs() < 1e-5 && (velocity - std::f64::consts::FRAC_PI_2).abs() < 1e-5);
        assert_eq!(reported(0x0C9, &payload), None, "another node");
        assert_eq!(reported(0x0A9, &payload[..6]), None, "six bytes");
        assert_eq!([reported(0x0A1, &payload), reported(0x0BC, &payload)], [None; 2], "no estimates");
    }

    #[test]
    fn gear_ratio_is_that_of_the_configuration() {
        let text = "[[bus]]\nname = \"arm\"\ninterface = \"can0\"\n\
                    [[motor]]\nname = \"elbow\"\nbus = \"arm\"\nid = 5\nprotocol = \"odrive\"\n";
        let protocol = |text: &str| Wiring::parse(text).unwrap().motors[0].protocol;
        assert_eq!(protocol(text), Protocol::Odrive(RotorAxis { gear_ratio: GEAR_RATIO }));
        let geared = format!("{text}gear-ratio = 5\n");
        assert_eq!(protocol(&geared), Protocol::Odrive(RotorAxis { gear_ratio: 5.0 }));
    }
}
