//! Frames of the MIT protocol, as a motor decodes them.
//!
//! Source: SteadyWin MIT document 1.1. Other vendors use the same layout with other [`Ranges`], and
//! other lengths and ids of a reply ([`ReplyFormat`]).

pub use super::codec::Meaning;
use super::codec::{Codec, Reported, eight_bytes};
use super::ranges::Ranges;
use motord_bus::Frame;
use serde::Deserialize;

/// MIT, as one vendor implements it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mit {
    /// The ranges of its codes.
    pub ranges: Ranges,
    /// The form of its replies.
    pub reply: ReplyFormat,
}

impl Codec for Mit {
    fn order(&self, frame: &Frame) -> Meaning {
        Meaning::of(eight_bytes(frame), &self.ranges)
    }

    fn reported(&self, frame: &Frame, id: u8) -> Option<Reported> {
        self.reply.read(frame.payload(), id, &self.ranges).map(Reported::State)
    }

    fn check(&self, frame: &Frame) {
        let is_fault_request = Meaning::of(eight_bytes(frame), &self.ranges) == Meaning::GetFault;
        assert!(
            self.reply.report.is_some() || !is_fault_request,
            "I1: a question that is a command to the motor"
        );
    }

    fn codes(&self) -> Option<Ranges> {
        Some(self.ranges.codes())
    }

    fn has_registers(&self) -> bool {
        self.reply.registers
    }
}

/// The form of a motor's replies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReplyFormat {
    /// Bits of the first byte that hold the motor's id: 0xFF, or 0x0F where the upper half is an
    /// error code.
    #[serde(rename = "id-mask")]
    pub id_mask: u8,
    /// Number of bytes of a reply to a command.
    pub length: usize,
    /// First byte of a fault report from which on all bytes are zero. `None` for a motor that must
    /// never receive a fault request: it would read it as a control frame.
    #[serde(rename = "report-zeros-from")]
    pub report: Option<usize>,
    /// The motor has registers, which a request to 0x7FF reads (DM_CAN.py, `__send_data`).
    #[serde(default)]
    pub registers: bool,
}

impl ReplyFormat {
    /// SteadyWin: the whole first byte is the id, and a reply has six bytes (MIT document 1.1).
    pub const STEADYWIN: Self = Self { id_mask: 0xFF, length: 6, report: Some(3), registers: false };

    /// Returns position, rad, and velocity, rad/s, of the reply of motor `id`. `None` for a fault
    /// report, and for other bytes.
    #[must_use]
    pub fn read(self, payload: &[u8], id: u8, ranges: &Ranges) -> Option<[f64; 2]> {
        let [first, high, low, fast, slow, ..] = *payload else { return None };
        let is_zero = |from: usize| payload[from..].iter().all(|byte| *byte == 0);
        let report = self.report.is_some_and(is_zero);
        if payload.len() != self.length || first & self.id_mask != id & self.id_mask || report {
            return None;
        }
        let position = u16::from_be_bytes([high, low]);
        let velocity = u16::from_be_bytes([fast, slow]) >> 4;
        let codes = ranges.codes();
        Some([
            f64::from(position) * codes.position - ranges.position,
            f64::from(velocity) * codes.velocity - ranges.velocity,
        ])
    }
}

/// The fields of a control command, as codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Codes {
    position: u16,
    velocity: u16,
    kp: u16,
    kd: u16,
    torque: u16,
}

impl Codes {
    /// Returns the fields: 16 bits of position, then 12 bits each.
    fn of(bytes: [u8; 8]) -> Self {
        let word = u64::from_be_bytes(bytes);
        let twelve = |shift: u32| (word >> shift) as u16 & 0xFFF;
        let position = (word >> 48) as u16;
        Self { position, velocity: twelve(36), kp: twelve(24), kd: twelve(12), torque: twelve(0) }
    }
}

/// Returns the value of a symmetric field of twelve bits.
fn symmetric(code: u16, most: f64) -> f64 {
    f64::from(code) * 2.0 * most / 4095.0 - most
}

/// Returns `true` when the code stands for zero. Zero lies between two codes, and both stand for
/// it.
const fn is_zero(code: u16) -> bool {
    matches!(code, 0x7FF | 0x800)
}

impl Meaning {
    /// Decodes the eight bytes of a command in MIT.
    #[must_use]
    pub fn of(bytes: [u8; 8], ranges: &Ranges) -> Self {
        match bytes {
            [255, 255, 255, 255, 255, 255, 255, 0xFC] => Self::Start,
            [255, 255, 255, 255, 255, 255, 255, 0xFD] => Self::Stop,
            [255, 255, 255, 255, 255, 255, 255, 0xFE] => Self::SetZero,
            [255, 255, 255, 255, 255, 255, 255, 0xFB] => Self::ClearFault,
            [255, 255, 255, 255, 255, 255, _, 0xFB] => Self::GetFault,
            _ => Self::of_fields(bytes, ranges),
        }
    }

    /// Decodes the eight bytes of a control command.
    pub(super) fn of_fields(bytes: [u8; 8], ranges: &Ranges) -> Self {
        let codes = Codes::of(bytes);
        Self::Control {
            position: f64::from(codes.position) * 2.0 * ranges.position / 65535.0 - ranges.position,
            velocity: symmetric(codes.velocity, ranges.velocity),
            kp: f64::from(codes.kp) * ranges.kp / 4095.0,
            kd: f64::from(codes.kd) * ranges.kd / 4095.0,
            torque: symmetric(codes.torque, ranges.torque),
            neutral: is_zero(codes.velocity) && is_zero(codes.torque),
        }
    }

    /// Returns `true` when the command has no stiffness, no torque and no speed to follow: it
    /// brakes at most.
    #[must_use]
    pub fn is_safe(&self) -> bool {
        match *self {
            Self::Stop | Self::GetFault | Self::ClearFault => true,
            Self::Control { kp, neutral, .. } => kp == 0.0 && neutral,
            _ => false,
        }
    }

    /// Returns `true` when the command only brakes.
    #[must_use]
    pub fn is_damping(&self) -> bool {
        matches!(*self, Self::Control { kd, .. } if kd > 0.0) && self.is_safe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RANGES: Ranges = Ranges::steadywin(20.0);

    /// 8123 7FF 0A4 099 812, computed by hand: 33059 · 25 / 65535 − 12.5 rad, 164 · 500 / 4095, 153
    /// · 5 / 4095 and 2066 · 40 / 4095 − 20 N·m.
    #[test]
    fn a_command_is_read_field_by_field() {
        let Meaning::Control { position, velocity, kp, kd, torque, neutral } =
            Meaning::of([0x81, 0x23, 0x7F, 0xF0, 0xA4, 0x09, 0x98, 0x12], &RANGES)
        else {
            panic!("it is a control command")
        };
        assert!((position - 0.111_200).abs() < 1e-5, "{position}");
        assert!((velocity + 0.015_873).abs() < 1e-5 && !neutral, "{velocity}");
        assert!((kp - 20.024_42).abs() < 1e-4, "{kp}");
        assert!((kd - 0.186_813).abs() < 1e-5, "{kd}");
        assert!((torque - 0.180_708).abs() < 1e-5, "{torque}");
    }

    #[test]
    fn a_command_with_any_pull_is_not_safe() {
        let is_safe = |bytes: u64| Meaning::of(bytes.to_be_bytes(), &RANGES).is_safe();
        for safe in
            [0x8123_7FF0_0009_97FF, 0x8123_8000_0009_9800, 0xFFFF_FFFF_FFFF_FFFD, 0xFFFF_FFFF_FFFF_01FB]
        {
            assert!(is_safe(safe), "{safe:016X}");
        }
        for pull in [
            0x8123_7FF0_0109_97FF_u64,
            0x8123_7FF0_0009_9801,
            0x8123_8010_0009_97FF,
            0x8123_7FE0_0009_97FF,
            0x8123_7FF0_0009_97FE,
            0xFFFF_FFFF_FFFF_FFFC,
            0xFFFF_FFFF_FFFF_FFFE,
            0,
        ] {
            assert!(!is_safe(pull), "{pull:016X}");
        }
    }
}
