//! Frames of the CANSimple dialect, as a driver decodes them.
//!
//! Source: chapter 4 of SteadyWin's manual of the GIM6010-8, and the vendor's SDK. The id has the
//! node in the upper six bits and the command in the lower five.

use super::codec::{Codec, Ids, Meaning, Reported, Sender};
use super::ranges::Ranges;
use motord_bus::Frame;

/// Rotor turns per turn of the output shaft of a GIM6010-8.
pub const GEAR_RATIO: f64 = 8.0;
/// A number that stands for every frame which no cycle may send.
const FORBIDDEN: u8 = 0xFF;

/// A motor with a CANSimple driver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// The ranges of its codes.
    pub ranges: Ranges,
    /// Rotor turns per turn of the output shaft.
    pub gear_ratio: f64,
}

impl Codec for Axis {
    /// The reply to an impedance has its id and six bytes. The answers to other questions have their id and
    /// their length.
    fn sender(&self, frame: &Frame, ids: &Ids) -> Option<Sender> {
        let raw = frame.id().raw();
        if frame.id().is_extended() || raw >> 5 != u32::from(ids.motor) {
            return None;
        }
        Some(match (raw & 0x1F, frame.payload().len()) {
            (0x01, _) | (0x08, 6) => Sender::Motor,
            (0x03 | 0x09 | 0x17, _) => Sender::Either,
            _ => Sender::Host,
        })
    }

    fn order(&self, frame: &Frame) -> Meaning {
        let (command, bytes) = parts(frame);
        match (command, bytes) {
            (0x03, [0, 0, 0, 0, ..]) => Meaning::GetFault,
            (0x07, [1, 0, 0, 0, ..]) => Meaning::Stop,
            (0x07, [8, 0, 0, 0, ..]) => Meaning::Start,
            (0x08, _) => Meaning::of_fields(bytes, &self.ranges),
            (0x09 | 0x17, _) => Meaning::GetIndicator,
            // The control mode of impedances. The axis stays as it is.
            (0x0B, [3, 0, 0, 0, 9, 0, 0, 0]) => Meaning::Start,
            (0x18, _) => Meaning::ClearFault,
            (0x19, [0, 0, 0, 0, ..]) => Meaning::SetZero,
            (0x03 | 0x07 | 0x0B | 0x19, _) => Meaning::Other(FORBIDDEN),
            (other, _) => Meaning::Other(other),
        }
    }

    fn reported(&self, frame: &Frame, id: u8) -> Option<Reported> {
        let raw = frame.id().raw();
        if frame.id().is_extended() || raw >> 5 != u32::from(id) {
            return None;
        }
        match (raw & 0x1F, frame.payload()) {
            (0x08, &[node, high, low, fast, slow, _]) if node == id => {
                let Ranges { position, velocity, .. } = self.ranges;
                let angle = f64::from(u16::from_be_bytes([high, low])) * 2.0 * position / 65535.0 - position;
                let speed = f64::from(u16::from_be_bytes([fast, slow]) >> 4);
                Some(Reported::State([angle, speed * 2.0 * velocity / 4095.0 - velocity]))
            }
            (0x09, &[a, b, c, d, e, f, g, h]) => {
                let turns = [[a, b, c, d], [e, f, g, h]].map(|bytes| f64::from(f32::from_le_bytes(bytes)));
                Some(Reported::State(turns.map(|turns| turns * std::f64::consts::TAU / self.gear_ratio)))
            }
            _ => None,
        }
    }

    fn codes(&self) -> Option<Ranges> {
        Some(self.ranges.codes())
    }
}

/// Returns the command and the payload.
///
/// # Panics
///
/// When the frame has not the form of every command of this protocol.
fn parts(frame: &Frame) -> (u8, [u8; 8]) {
    assert!(!frame.id().is_extended() && frame.is_classic(), "I1: {frame:?} has another form");
    ((frame.id().raw() & 0x1F) as u8, frame.payload().try_into().expect("every command has eight bytes"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::FrameId;

    const AXIS: Axis = Axis {
        ranges: Ranges { position: 12.5, velocity: 65.0, kp: 500.0, kd: 5.0, torque: 50.0 },
        gear_ratio: GEAR_RATIO,
    };

    fn frame(id: u16, payload: &[u8]) -> Frame {
        Frame::new(FrameId::new(id).unwrap(), payload).unwrap()
    }

    /// 0x8A3D, 0x83E, 0x1EB, 0x4CC and 0x87A, computed by hand. No bytes of it are a special frame.
    #[test]
    fn control_has_fields_of_mit_without_special_frames() {
        let of = |word: u64| AXIS.order(&frame(0x0A8, &word.to_be_bytes()));
        let Meaning::Control { position, velocity, kp, kd, torque, neutral } = of(0x8A3D_83E1_EB4C_C87A)
        else {
            panic!("it is a control command")
        };
        assert!((position - 1.000_038).abs() < 1e-5 && !neutral, "{position}");
        assert!((velocity - 1.984_127).abs() < 1e-5, "{velocity}");
        assert!((kp - 59.951_160).abs() < 1e-5, "{kp}");
        assert!((kd - 1.499_389).abs() < 1e-5, "{kd}");
        assert!((torque - 2.991_453).abs() < 1e-5, "{torque}");
        assert!(matches!(of(0xFFFF_FFFF_FFFF_FFFC), Meaning::Control { .. }));
    }

    #[test]
    fn request_that_equals_its_answer_has_either_sender() {
        let ids = Ids { motor: 5, reply: FrameId::from(0xA8) };
        let sender = |id, length| AXIS.sender(&frame(id, &[0; 8][..length]), &ids);
        assert_eq!([sender(0x0A8, 8), sender(0x0A7, 8)], [Some(Sender::Host); 2]);
        assert_eq!([sender(0x0A8, 6), sender(0x0A1, 8)], [Some(Sender::Motor); 2]);
        assert_eq!([sender(0x0A3, 8), sender(0x0A9, 8)], [Some(Sender::Either); 2]);
        assert_eq!([sender(0x0C8, 8), sender(0x088, 6)], [None; 2]);
    }

    #[test]
    fn only_a_cycles_commands_are_permitted() {
        for (id, first, meaning) in [
            (0x0A3, 0, Meaning::GetFault),
            (0x0A7, 1, Meaning::Stop),
            (0x0A7, 8, Meaning::Start),
            (0x0A9, 0, Meaning::GetIndicator),
            (0x0B7, 0, Meaning::GetIndicator),
            (0x0B8, 0, Meaning::ClearFault),
            (0x0B9, 0, Meaning::SetZero),
        ] {
            let frame = frame(id, &[first, 0, 0, 0, 0, 0, 0, 0]);
            AXIS.check(&frame);
            assert_eq!(AXIS.order(&frame), meaning);
        }
        // Calibration, emergency stop, node id, other modes, restart, save.
        for (id, first) in [(0x0A7, 3), (0x0A2, 0), (0x0A6, 7), (0x0AB, 1), (0x0B6, 0), (0x0BF, 0)] {
            let frame = frame(id, &[first, 0, 0, 0, 0, 0, 0, 0]);
            let forbidden = std::panic::catch_unwind(|| AXIS.check(&frame));
            assert!(forbidden.is_err(), "{id:#x}");
        }
    }

    /// 0x5F3B and 0x58A; -0.64 turns of the rotor are 0xBF23D70A.
    #[test]
    fn state_of_this_node_alone_is_read() {
        let reported = |id, payload: &[u8]| match AXIS.reported(&frame(id, payload), 5) {
            Some(Reported::State(state)) => Some(state),
            _ => None,
        };
        let [position, velocity] = reported(0x0A8, &[5, 0x5F, 0x3B, 0x58, 0xA6, 0x3D]).unwrap();
        assert!((position + 3.200_008).abs() < 1e-5 && (velocity + 19.984_127).abs() < 1e-5);
        let [position, velocity] = reported(0x0A9, &[0x0A, 0xD7, 0x23, 0xBF, 0, 0, 0, 0]).unwrap();
        assert!((position + 0.502_655).abs() < 1e-5 && velocity == 0.0);
        assert_eq!(reported(0x0C8, &[5, 0x5F, 0x3B, 0x58, 0xA6, 0x3D]), None, "another node");
        assert_eq!(reported(0x0A1, &[0; 8]), None, "a heartbeat");
    }
}
