//! Frames of the native protocol, as a motor decodes them, over CAN and on a serial line.
//!
//! Source: SteadyWin GIM document 2.2. Floats and the position of a reply have the low byte first,
//! the speed of a reply does not.

use super::codec::{Codec, Meaning, Reported, eight_bytes};
use super::ranges::Ranges;
use motord_bus::Frame;

/// One rad/s in rpm.
const RPM: f64 = 30.0 / std::f64::consts::PI;
/// Largest position of a reply, rad, of 65 535 codes (3.2.7).
pub const POSITION: f64 = 12.5;
/// Largest speed of a reply, rad/s, of 4095 codes (3.2.7).
pub const VELOCITY: f64 = 65.0;

/// Decodes the eight bytes of a command. Sources: 3.2.5 to 3.2.9, 3.2.15 to 3.2.17.
#[must_use]
pub fn decode(bytes: [u8; 8]) -> Meaning {
    let [command, a, b, c, d, ..] = bytes;
    let value = f64::from(f32::from_le_bytes([a, b, c, d]));
    match command {
        0x91 => Meaning::Start,
        0x92 => Meaning::Stop,
        0x93 => Meaning::Torque(value),
        0x94 => Meaning::Speed(value / RPM),
        0x95 => Meaning::Position(value),
        0xB2 => Meaning::GetFault,
        0xB3 => Meaning::ClearFault,
        0xB4 => Meaning::GetIndicator,
        other => Meaning::Other(other),
    }
}

/// Decodes the motion in the payload of a reply: the state after a control command, the angle of
/// the output shaft (indicator 0x13), or its speed (0x14). `None` for other replies, and for a
/// failure.
#[must_use]
pub fn reported(payload: &[u8]) -> Option<Reported> {
    match *payload {
        [0x93..=0x95, 0, _temperature, low, high, fast, slow, _torque] => {
            let position = f64::from(u16::from_le_bytes([low, high]));
            let velocity = f64::from(u16::from_be_bytes([fast, slow]) >> 4);
            let position = position * 2.0 * POSITION / 65535.0 - POSITION;
            Some(Reported::State([position, velocity * 2.0 * VELOCITY / 4095.0 - VELOCITY]))
        }
        [0xB4, 0x13, 0, _, a, b, c, d] => Some(Reported::Angle(f32::from_le_bytes([a, b, c, d]).into())),
        [0xB4, 0x14, 0, _, a, b, c, d] => {
            Some(Reported::Speed(f64::from(f32::from_le_bytes([a, b, c, d])) / RPM))
        }
        _ => None,
    }
}

/// The native protocol.
pub(super) struct Native;

impl Codec for Native {
    fn order(&self, frame: &Frame) -> Meaning {
        decode(eight_bytes(frame))
    }

    fn reported(&self, frame: &Frame, _id: u8) -> Option<Reported> {
        reported(frame.payload())
    }

    /// No control command is neutral in MIT mode. It may be sent: the motor has answered in native
    /// mode before.
    fn check(&self, frame: &Frame) {
        let bytes = eight_bytes(frame);
        let in_mit = Meaning::of(bytes, &Ranges::steadywin(1.0));
        let is_control = matches!(bytes[0], 0x93..=0x95);
        assert!(is_control || in_mit.is_safe(), "I1: {bytes:02X?} is {in_mit:?} in MIT mode");
    }

    fn codes(&self) -> Option<Ranges> {
        None
    }

    fn reports_parts(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1.5 is 0x3FC00000, π is 0x40490FDB, 60.0 is 0x42700000 (IEEE 754); 60 rpm is one turn per
    /// second. Durations of 0, 2000 and 100 ms.
    #[test]
    fn control_command_is_read_as_documented() {
        let of = |bytes: u64| decode(bytes.to_be_bytes());
        assert_eq!(of(0x9300_00C0_3F00_0000), Meaning::Torque(1.5));
        assert_eq!(of(0x95DB_0F49_40D0_0700), Meaning::Position(f64::from(std::f32::consts::PI)));
        let Meaning::Speed(speed) = of(0x9400_0070_4264_0000) else { panic!("it is a speed") };
        assert!((speed - std::f64::consts::TAU).abs() < 1e-9, "{speed}");
    }

    /// Table 4.
    #[test]
    fn every_other_command_byte_is_recognised() {
        let of = |command: u8| decode([command, 0, 0, 0, 0, 0, 0, 0]);
        let known = [
            (0x91, Meaning::Start),
            (0x92, Meaning::Stop),
            (0xB2, Meaning::GetFault),
            (0xB3, Meaning::ClearFault),
            (0xB4, Meaning::GetIndicator),
        ];
        for (command, meaning) in known {
            assert_eq!(of(command), meaning);
        }
        for other in [0x00, 0x81, 0x82, 0x83, 0x84, 0x96, 0x97, 0xA1, 0xA2, 0xB1, 0xB5, 0xC1, 0xFF] {
            assert_eq!(of(other), Meaning::Other(other));
        }
    }

    /// 0x3412 · 25 / 65535 − 12.5 rad and 0x567 · 130 / 4095 − 65 rad/s, computed by hand. 1.5 rad;
    /// 60 rpm. 0x01 is a failure.
    #[test]
    fn reply_holds_position_velocity_both_or_neither() {
        let reported = |bytes: u64| super::reported(&bytes.to_be_bytes());
        for command in [0x93_u64, 0x94, 0x95] {
            let Some(Reported::State([position, velocity])) =
                reported((command << 56) | 0x0000_2812_3456_789A)
            else {
                panic!("{command:#X} has a state")
            };
            assert!((position + 7.414_931).abs() < 1e-5, "{position}");
            assert!((velocity + 21.095_238).abs() < 1e-5, "{velocity}");
        }
        assert_eq!(reported(0xB413_0000_0000_C03F), Some(Reported::Angle(1.5)));
        let Some(Reported::Speed(speed)) = reported(0xB414_0000_0000_7042) else { panic!("it is a speed") };
        assert!((speed - std::f64::consts::TAU).abs() < 1e-9, "{speed}");
        for nothing in
            [0x9301_2812_3456_789A, 0xB413_0100_0000_C03F, 0xB400_0000_0000_C03F, 0x9100_0000_0000_0000]
        {
            assert_eq!(reported(nothing), None, "{nothing:016X}");
        }
        assert_eq!(super::reported(&[0x93, 0, 0x28, 0x12, 0x34, 0x56]), None);
    }
}
