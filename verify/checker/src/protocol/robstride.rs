//! Frames of RobStride's private protocol, as a motor decodes them.
//!
//! Source: the vendor's manuals of 2026-04-28, chapter "private communication protocol". The id has
//! the type in bits 24 to 28, 16 bits of data, and the receiver in bits 0 to 7.

use super::codec::{Codec, Ids, Meaning, Reported, Sender};
use super::ranges::Ranges;
use motord_bus::Frame;

/// Largest code of every field.
const CODES: f64 = 65535.0;
/// The two codes beside zero of a symmetric range.
const ZEROS: [u16; 2] = [0x7FFF, 0x8000];

/// RobStride's private protocol.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Private {
    /// The ranges of its codes.
    pub ranges: Ranges,
}

impl Codec for Private {
    /// The motor that a frame is to or from is in the lower half of the id.
    fn sender(&self, frame: &Frame, ids: &Ids) -> Option<Sender> {
        let raw = frame.id().raw();
        let [kind, _, data, target] = raw.to_be_bytes();
        let is_from_motor = matches!(kind, 0x00 | 0x02 | 0x11 | 0x15 | 0x18) && data == ids.motor;
        match frame.id().is_extended() {
            true if target == ids.motor => Some(Sender::Host),
            true if is_from_motor => Some(Sender::Motor),
            _ => None,
        }
    }

    fn order(&self, frame: &Frame) -> Meaning {
        let (id, bytes) = parts(frame);
        match (id >> 24, bytes[0]) {
            (1, _) => self.control((id >> 8) as u16, bytes),
            (3, _) => Meaning::Start,
            (4, 0) => Meaning::Stop,
            (4, 1) => Meaning::ClearFault,
            (6, 1) => Meaning::SetZero,
            (0x11, 0x1C) if bytes[1] == 0x70 => Meaning::GetIndicator,
            (other, _) => Meaning::Other(other as u8),
        }
    }

    fn reported(&self, frame: &Frame, id: u8) -> Option<Reported> {
        let raw = frame.id().raw();
        let bytes: [u8; 8] = frame.payload().try_into().ok()?;
        let is_state = frame.id().is_extended() && raw >> 24 == 2 && (raw >> 8) as u8 == id;
        if !is_state || bytes.starts_with(&[0x00, 0xC4, 0x56]) {
            return None;
        }
        let [position, velocity, ..] = fields(bytes);
        let Ranges { position: angle, velocity: speed, .. } = self.ranges;
        Some(Reported::State([symmetric(position, angle), symmetric(velocity, speed)]))
    }

    fn codes(&self) -> Option<Ranges> {
        let Ranges { position, velocity, kp, kd, torque } = self.ranges;
        Some(Ranges {
            position: 2.0 * position / CODES,
            velocity: 2.0 * velocity / CODES,
            kp: kp / CODES,
            kd: kd / CODES,
            torque: 2.0 * torque / CODES,
        })
    }
}

impl Private {
    fn control(&self, torque: u16, bytes: [u8; 8]) -> Meaning {
        let [position, velocity, kp, kd] = fields(bytes);
        let ranges = &self.ranges;
        Meaning::Control {
            position: symmetric(position, ranges.position),
            velocity: symmetric(velocity, ranges.velocity),
            kp: f64::from(kp) * ranges.kp / CODES,
            kd: f64::from(kd) * ranges.kd / CODES,
            torque: symmetric(torque, ranges.torque),
            neutral: ZEROS.contains(&velocity) && ZEROS.contains(&torque),
        }
    }
}

/// Returns the 29 bits of the id, and the payload.
///
/// # Panics
///
/// When the frame has not the form of every frame of this protocol.
fn parts(frame: &Frame) -> (u32, [u8; 8]) {
    assert!(frame.id().is_extended() && frame.is_classic(), "I1: {frame:?} has another form");
    (frame.id().raw(), frame.payload().try_into().expect("every command has eight bytes"))
}

fn fields([a, b, c, d, e, f, g, h]: [u8; 8]) -> [u16; 4] {
    [[a, b], [c, d], [e, f], [g, h]].map(u16::from_be_bytes)
}

fn symmetric(code: u16, most: f64) -> f64 {
    f64::from(code) * 2.0 * most / CODES - most
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::FrameId;

    const PRIVATE: Private =
        Private { ranges: Ranges { position: 12.57, velocity: 44.0, kp: 500.0, kd: 5.0, torque: 17.0 } };

    fn frame(id: u32, payload: u64) -> Frame {
        Frame::classic(FrameId::extended(id).unwrap(), payload.to_be_bytes())
    }

    /// 0xA000 of torque is 40960 · 34 / 65535 − 17 N·m, in the id; 0x8A3D, 0x8BA2, 0x199A and 0x3333
    /// are in the payload. Computed by hand.
    #[test]
    fn torque_of_a_command_is_in_its_id() {
        let order = PRIVATE.order(&frame(0x01A0_0005, 0x8A3D_8BA2_199A_3333));
        let Meaning::Control { position, velocity, kp, kd, torque, neutral } = order else {
            panic!("it is a control command")
        };
        assert!((position - 1.005_638).abs() < 1e-5 && !neutral, "{position}");
        assert!((velocity - 3.999_512).abs() < 1e-5, "{velocity}");
        assert!((kp - 50.003_815).abs() < 1e-5, "{kp}");
        assert!((kd - 1.0).abs() < 1e-5, "{kd}");
        assert!((torque - 4.250_324).abs() < 1e-5, "{torque}");
    }

    #[test]
    fn sender_is_in_the_id() {
        let ids = Ids { motor: 5, reply: FrameId::from(0xFD) };
        let sender = |id| PRIVATE.sender(&frame(id, 0), &ids);
        assert_eq!(sender(0x01A0_0005), Some(Sender::Host));
        assert_eq!(sender(0x0280_05FD), Some(Sender::Motor));
        assert_eq!([sender(0x01A0_0006), sender(0x0280_06FD)], [None, None]);
    }

    #[test]
    fn only_a_cycles_commands_are_permitted() {
        for (id, payload, meaning) in [
            (0x0300_FD05, 0, Meaning::Start),
            (0x0400_FD05, 0, Meaning::Stop),
            (0x0400_FD05, 0x0100_0000_0000_0000, Meaning::ClearFault),
            (0x0600_FD05, 0x0100_0000_0000_0000, Meaning::SetZero),
            (0x1100_FD05, 0x1C70_0000_0000_0000, Meaning::GetIndicator),
        ] {
            PRIVATE.check(&frame(id, payload));
            assert_eq!(PRIVATE.order(&frame(id, payload)), meaning);
        }
        for id in [0x0000_FD05, 0x0706_FD05, 0x1100_FD05, 0x1200_FD05, 0x1600_FD05, 0x1900_FD05] {
            let forbidden = std::panic::catch_unwind(|| PRIVATE.check(&frame(id, 0)));
            assert!(forbidden.is_err(), "{id:#x}");
        }
    }

    /// 0x9000 is 36864 · 25.14 / 65535 − 12.57 rad.
    #[test]
    fn state_of_this_motor_alone_is_read() {
        let reported = |id, payload| PRIVATE.reported(&frame(id, payload), 5);
        let Some(Reported::State([position, velocity])) = reported(0x0280_05FD, 0x9000_8000_8000_0104) else {
            panic!("it is a state")
        };
        assert!((position - 1.571_466).abs() < 1e-5, "{position}");
        assert!((velocity - 0.000_671).abs() < 1e-6, "{velocity}");
        assert_eq!(reported(0x0280_06FD, 0x9000_8000_8000_0104), None, "another motor");
        assert_eq!(reported(0x0280_05FD, 0x00C4_5603_0503_0700), None, "a version");
        assert_eq!(reported(0x1880_05FD, 0x9000_8000_8000_0104), None, "unasked");
    }
}
