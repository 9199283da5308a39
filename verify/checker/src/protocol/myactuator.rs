//! Frames of MyActuator's protocol, as a motor decodes them.
//!
//! Source: the protocol document V4.2. A command has the id 0x140 + motor and its answer 0x240 + motor, an
//! impedance 0x400 + motor and its answer 0x500 + motor.

use super::codec::{Codec, Ids, Meaning, Reported, Sender};
use super::ranges::Ranges;
use motord_bus::Frame;

/// A motor of the RMD series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rmd {
    /// The ranges of its codes.
    pub ranges: Ranges,
}

impl Codec for Rmd {
    fn sender(&self, frame: &Frame, ids: &Ids) -> Option<Sender> {
        match frame.id().raw().checked_sub(ids.motor.into()) {
            _ if frame.id().is_extended() => None,
            Some(0x140 | 0x400) => Some(Sender::Host),
            Some(0x240 | 0x500) => Some(Sender::Motor),
            _ => None,
        }
    }

    fn order(&self, frame: &Frame) -> Meaning {
        let (is_impedance, bytes) = parts(frame);
        match bytes {
            _ if is_impedance => Meaning::of_fields(bytes, &self.ranges),
            [0x64, 0, 0, 0, 0, 0, 0, 0] => Meaning::SetZero,
            // After a restart the motor is limp, as after a stop. Neither moves it.
            [0x76 | 0x80, 0, 0, 0, 0, 0, 0, 0] => Meaning::Stop,
            [0x92 | 0x9C, 0, 0, 0, 0, 0, 0, 0] => Meaning::GetIndicator,
            [0x9A, 0, 0, 0, 0, 0, 0, 0] => Meaning::GetFault,
            [other, ..] => Meaning::Other(other),
        }
    }

    fn reported(&self, frame: &Frame, id: u8) -> Option<Reported> {
        let bytes: [u8; 8] = frame.payload().try_into().ok()?;
        let number = u32::from(id);
        match (frame.id().raw(), bytes) {
            (raw, [first, high, low, fast, slow, ..]) if raw == 0x500 + number && first == id => {
                let Ranges { position, velocity, .. } = self.ranges;
                let angle = f64::from(u16::from_be_bytes([high, low])) / 65535.0;
                let speed = f64::from(u16::from_be_bytes([fast, slow]) >> 4) / 4095.0;
                Some(Reported::State([(2.0 * angle - 1.0) * position, (2.0 * speed - 1.0) * velocity]))
            }
            (raw, [0x92, _, _, _, a, b, c, d]) if raw == 0x240 + number => {
                Some(Reported::Angle((f64::from(i32::from_le_bytes([a, b, c, d])) / 100.0).to_radians()))
            }
            (raw, [0x9C, _, _, _, low, high, _, _]) if raw == 0x240 + number => {
                Some(Reported::Speed(f64::from(i16::from_le_bytes([low, high])).to_radians()))
            }
            _ => None,
        }
    }

    fn codes(&self) -> Option<Ranges> {
        Some(self.ranges.codes())
    }

    fn reports_parts(&self) -> bool {
        true
    }
}

/// Returns whether a command is an impedance, and its payload.
///
/// # Panics
///
/// When the frame has not the form of every command of this protocol, or begins with six bytes 0xFF:
/// a special frame of MIT would be full torque.
fn parts(frame: &Frame) -> (bool, [u8; 8]) {
    assert!(!frame.id().is_extended() && frame.is_classic(), "I1: {frame:?} has another form");
    let bytes: [u8; 8] = frame.payload().try_into().expect("every command has eight bytes");
    assert!(!bytes.starts_with(&[0xFF; 6]), "I1: {frame:?} is a special frame of MIT");
    (frame.id().raw() >= 0x400, bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::FrameId;

    const RMD: Rmd =
        Rmd { ranges: Ranges { position: 12.5, velocity: 45.0, kp: 500.0, kd: 5.0, torque: 24.0 } };

    fn frame(id: u16, payload: &[u8]) -> Frame {
        Frame::new(FrameId::new(id).unwrap(), payload).unwrap()
    }

    /// The example of the document.
    #[test]
    fn example_of_the_document_is_an_impedance() {
        let example = frame(0x405, &[0xE6, 0x66, 0x82, 0xE0, 0x52, 0x33, 0x3B, 0x55]);
        let Meaning::Control { position, velocity, kp, kd, torque, neutral } = RMD.order(&example) else {
            panic!("it is a control command")
        };
        assert!((position - 10.0).abs() < 4e-4 && (velocity - 1.0).abs() < 0.022, "{position} {velocity}");
        assert!((kp - 10.0).abs() < 0.13 && (kd - 1.0).abs() < 1e-3 && (torque - 10.0).abs() < 0.012);
        assert!(!neutral);
    }

    #[test]
    fn only_a_cycles_commands_are_permitted() {
        for (first, meaning) in [
            (0x64, Meaning::SetZero),
            (0x76, Meaning::Stop),
            (0x80, Meaning::Stop),
            (0x92, Meaning::GetIndicator),
            (0x9A, Meaning::GetFault),
            (0x9C, Meaning::GetIndicator),
        ] {
            let frame = frame(0x145, &[first, 0, 0, 0, 0, 0, 0, 0]);
            RMD.check(&frame);
            assert_eq!(RMD.order(&frame), meaning);
        }
        // Function, brake, stop that holds, torque, speed, position, timeout, bit rate; MIT's enable.
        let commands = [0x20, 0x77, 0x81, 0xA1, 0xA2, 0xA4, 0xB3, 0xB4];
        let frames = commands.map(|first| frame(0x145, &[first, 0, 0, 0, 0, 0, 0, 0]));
        let special = frame(0x405, &[0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC]);
        for frame in frames.into_iter().chain([special]) {
            assert!(std::panic::catch_unwind(|| RMD.check(&frame)).is_err(), "{frame:?}");
        }
    }

    /// 0x5F3B and 0x58A; 12345 · 0.01° is 2.154609 rad; -100 °/s is -1.745329 rad/s.
    #[test]
    fn motion_of_this_motor_alone_is_read() {
        let of = |id, payload: &[u8]| RMD.reported(&frame(id, payload), 5);
        let state = of(0x505, &[5, 0x5F, 0x3B, 0x58, 0xA6, 0x3D, 0, 0]);
        let Some(Reported::State([position, velocity])) = state else { panic!("a state") };
        assert!((position + 3.200_008).abs() < 1e-5 && (velocity + 13.835_165).abs() < 1e-5);
        let angle = of(0x245, &[0x92, 0, 0, 0, 0x39, 0x30, 0, 0]);
        assert!(matches!(angle, Some(Reported::Angle(angle)) if (angle - 2.154_609).abs() < 1e-5));
        let speed = of(0x245, &[0x9C, 25, 0, 0, 0x9C, 0xFF, 0, 0]);
        assert!(matches!(speed, Some(Reported::Speed(speed)) if (speed + 1.745_329).abs() < 1e-5));
        assert_eq!(of(0x505, &[6, 0x5F, 0x3B, 0x58, 0xA6, 0x3D, 0, 0]), None, "another motor");
        assert_eq!(of(0x245, &[0x9A, 25, 0, 1, 0xE0, 1, 0, 0]), None, "a status");
    }
}
