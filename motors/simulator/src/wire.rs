//! Frames from the motor's side: the meaning of a command, and the layout of an answer.
//!
//! Written independently from the documents, without the host's codec, so that one error cannot
//! hide in both. Both are tested with the same golden frames.

use crate::settings::BeyondRange;
use motord_bus::{Frame, Instant};
use std::collections::VecDeque;

/// A quantity as an unsigned code: `value = code · span / codes + min` (MIT document 1.1, GIM
/// document 3.2.7).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Scale {
    min: f64,
    span: f64,
    codes: f64,
}

/// Output shaft, rad.
pub(crate) const POSITION: Scale = Scale { min: -12.5, span: 25.0, codes: 65535.0 };
/// Output shaft, rad/s.
pub(crate) const VELOCITY: Scale = Scale { min: -65.0, span: 130.0, codes: 4095.0 };

impl Scale {
    /// Returns the scale from `-end` to `end`, with this largest code.
    pub(crate) const fn symmetric(end: f64, codes: f64) -> Self {
        Self { min: -end, span: 2.0 * end, codes }
    }

    /// Returns the scale of a gain from zero to `end`.
    pub(crate) const fn from_zero(end: f64) -> Self {
        Self { min: 0.0, span: end, codes: 4095.0 }
    }

    /// Returns the scale with this largest code.
    pub(crate) const fn with_codes(self, codes: f64) -> Self {
        Self { codes, ..self }
    }

    /// Returns the scale of torque at the output shaft, N·m: ±225 A times the rotor's constant
    /// (N·m/A) times the gear ratio.
    pub(crate) fn torque(torque_constant: f64, gear_ratio: f64) -> Self {
        let span = 450.0 * torque_constant * gear_ratio;
        Self { min: -span / 2.0, span, codes: 4095.0 }
    }

    pub(crate) fn value(self, code: u16) -> f64 {
        f64::from(code) * self.span / self.codes + self.min
    }

    /// Returns the code of `value`, below zero or beyond the range when the value is.
    fn code(self, value: f64, truncates: bool) -> i64 {
        let exact = (value - self.min) * self.codes / self.span;
        (exact + if truncates { 0.0 } else { 0.5 }).floor() as i64
    }

    fn clamped(self, value: f64, truncates: bool) -> u16 {
        self.code(value, truncates).clamp(0, self.codes as i64) as u16
    }
}

/// An MIT frame to the motor (MIT document 1.1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum MitCommand {
    Start,
    Stop,
    SetZero,
    GetFault,
    ClearFault,
    Control(Control),
}

/// The codes of a dynamic control frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Control {
    pub(crate) position: u16,
    pub(crate) velocity: u16,
    pub(crate) kp: u16,
    pub(crate) kd: u16,
    pub(crate) torque: u16,
}

impl MitCommand {
    /// Returns `None` for a payload that does not have eight bytes.
    pub(crate) fn decode(payload: &[u8]) -> Option<Self> {
        Some(match payload {
            [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC] => Self::Start,
            [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFD] => Self::Stop,
            [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFE] => Self::SetZero,
            [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFB] => Self::ClearFault,
            [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, _, 0xFB] => Self::GetFault,
            _ => Self::Control(Control::decode(payload)?),
        })
    }
}

impl Control {
    /// Returns `None` for a payload that does not have eight bytes.
    pub(crate) fn decode(payload: &[u8]) -> Option<Self> {
        let &[p1, p0, v1, v0_kp1, kp0, kd1, kd0_t1, t0] = payload else { return None };
        Some(Self {
            position: u16::from_be_bytes([p1, p0]),
            velocity: u16::from(v1) * 16 + u16::from(v0_kp1) / 16,
            kp: u16::from(v0_kp1) % 16 * 256 + u16::from(kp0),
            kd: u16::from(kd1) * 16 + u16::from(kd0_t1) / 16,
            torque: u16::from(kd0_t1) % 16 * 256 + u16::from(t0),
        })
    }
}

/// The state of the shaft as codes, which both protocols report.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct State {
    pub(crate) position: u16,
    pub(crate) velocity: u16,
    pub(crate) torque: u16,
}

impl State {
    /// Encodes `position` in rad, `velocity` in rad/s, `torque` in N·m, each by its scale.
    pub(crate) fn encode(
        [position, velocity, torque]: [f64; 3],
        scales: [Scale; 3],
        truncates: bool,
        beyond: BeyondRange,
    ) -> Self {
        let position = match beyond {
            BeyondRange::Wraps => scales[0].code(position, truncates) as u16,
            BeyondRange::Clamps => scales[0].clamped(position, truncates),
        };
        Self {
            position,
            velocity: scales[1].clamped(velocity, truncates),
            torque: scales[2].clamped(torque, truncates),
        }
    }

    /// Returns the second to sixth byte of a state in MIT (MIT document 1.2): position high byte
    /// first.
    pub(crate) fn mit(self) -> [u8; 5] {
        let [p1, p0] = self.position.to_be_bytes();
        let [st0, st1, st2] = self.speed_and_torque();
        [p1, p0, st0, st1, st2]
    }

    /// Returns the layout of GIM document 3.2.7: position low byte first, the temperature in °C as
    /// a signed byte.
    pub(crate) fn gim(self, command: u8, temperature: i8) -> [u8; 8] {
        let [p0, p1] = self.position.to_le_bytes();
        let [st0, st1, st2] = self.speed_and_torque();
        [command, result::SUCCESS, temperature as u8, p0, p1, st0, st1, st2]
    }

    fn speed_and_torque(self) -> [u8; 3] {
        let Self { velocity, torque, .. } = self;
        [(velocity / 16) as u8, (velocity % 16 * 16 + torque / 256) as u8, (torque % 256) as u8]
    }
}

/// Result codes that a motor returns (GIM document, table 5).
pub(crate) mod result {
    pub(crate) const SUCCESS: u8 = 0x00;
    pub(crate) const FAILURE: u8 = 0x01;
    pub(crate) const UNKNOWN_COMMAND: u8 = 0x02;
    pub(crate) const READ_ONLY: u8 = 0x04;
    pub(crate) const UNKNOWN_REGISTER: u8 = 0x05;
    pub(crate) const DATA_FORMAT: u8 = 0x07;
}

/// Command bytes (GIM document, table 4, and 3.2.18).
pub(crate) mod command {
    pub(crate) const RESET_CONFIGURATION: u8 = 0x81;
    pub(crate) const REFRESH_CONFIGURATION: u8 = 0x82;
    pub(crate) const MODIFY_CONFIGURATION: u8 = 0x83;
    pub(crate) const RETRIEVE_CONFIGURATION: u8 = 0x84;
    pub(crate) const START: u8 = 0x91;
    pub(crate) const STOP: u8 = 0x92;
    pub(crate) const TORQUE: u8 = 0x93;
    pub(crate) const SPEED: u8 = 0x94;
    pub(crate) const POSITION: u8 = 0x95;
    pub(crate) const STOP_CONTROL: u8 = 0x97;
    pub(crate) const MODIFY_PARAMETER: u8 = 0xA1;
    pub(crate) const RETRIEVE_PARAMETER: u8 = 0xA2;
    pub(crate) const GET_VERSION: u8 = 0xB1;
    pub(crate) const GET_FAULT: u8 = 0xB2;
    pub(crate) const ACKNOWLEDGE_FAULT: u8 = 0xB3;
    pub(crate) const RETRIEVE_INDICATOR: u8 = 0xB4;
    pub(crate) const CALIBRATE: u8 = 0xB5;
    pub(crate) const UPDATE_FIRMWARE: u8 = 0xC1;
}

/// Returns a native answer that is not a state: echo, result and data where its command has them
/// (GIM document 3.2.1 ff.). Bytes without a meaning are those of `filler`, as are the data of an
/// answer that has none.
pub(crate) fn answer(filler: [u8; 8], request: [u8; 8], result: u8, data: Option<[u8; 4]>) -> [u8; 8] {
    use command::{CALIBRATE, GET_FAULT, RETRIEVE_INDICATOR};
    let [command, sub, id, ..] = request;
    let [_, _, f2, f3, f4, f5, f6, f7] = filler;
    let [d0, d1, d2, d3] = data.unwrap_or([f4, f5, f6, f7]);
    match command {
        command::MODIFY_CONFIGURATION | command::RETRIEVE_CONFIGURATION => {
            [command, sub, id, result, d0, d1, d2, d3]
        }
        command::MODIFY_PARAMETER | command::RETRIEVE_PARAMETER | RETRIEVE_INDICATOR => {
            [command, sub, result, f3, d0, d1, d2, d3]
        }
        // 3.2.18 prints the indicator's command byte in this answer, in both languages.
        CALIBRATE => [RETRIEVE_INDICATOR, sub, result, f3, f4, f5, f6, f7],
        GET_FAULT => [command, result, data.map_or(f2, |[fault, ..]| fault), f3, f4, f5, f6, f7],
        _ => [command, result, f2, f3, d0, d1, d2, d3],
    }
}

/// Returns value and duration (ms) of a torque, speed or position command (GIM document 3.2.7 to
/// 3.2.9).
pub(crate) fn gim_control([_, v0, v1, v2, v3, d0, d1, d2]: [u8; 8]) -> (f32, u32) {
    (f32::from_le_bytes([v0, v1, v2, v3]), u32::from_le_bytes([d0, d1, d2, 0]))
}

/// A frame that was complete on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Recorded {
    /// The frame has waited for the wire since this time. A frame of the host waits from its send.
    pub ready: Instant,
    /// The end of the frame.
    pub at: Instant,
    /// Its direction.
    pub direction: Direction,
    /// The frame.
    pub frame: Frame,
}

/// The direction of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// From the host.
    ToMotor,
    /// From a motor or a flood.
    ToHost,
}

/// The newest frames; never grows.
#[derive(Debug, Clone)]
pub(crate) struct Record {
    frames: VecDeque<Recorded>,
    capacity: usize,
}

impl Record {
    pub(crate) fn new(capacity: usize) -> Self {
        Self { frames: VecDeque::with_capacity(capacity), capacity }
    }

    pub(crate) fn push(&mut self, recorded: Recorded) {
        if self.capacity == 0 {
            return;
        }
        if self.frames.len() == self.capacity {
            self.frames.pop_front();
        }
        self.frames.push_back(recorded);
    }

    pub(crate) fn take(&mut self) -> impl Iterator<Item = Recorded> + '_ {
        self.frames.drain(..)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    /// Returns frames computed by hand from the vendor documents; torque constant 0.1 N·m/A, gear
    /// ratio 8.
    fn golden(protocol: &str, direction: &str) -> Vec<(Vec<u8>, Value)> {
        let text = include_str!("../../protocol/tests/golden_vectors.json");
        let all: Vec<Value> = serde_json::from_str(text).unwrap();
        let wanted = all.into_iter().filter(|v| v["protocol"] == protocol && v["direction"] == direction);
        wanted.map(|vector| (unhex(vector["hex"].as_str().unwrap()), vector)).collect()
    }

    fn unhex(text: &str) -> Vec<u8> {
        text.as_bytes()
            .chunks(2)
            .map(|pair| u8::from_str_radix(core::str::from_utf8(pair).unwrap(), 16).unwrap())
            .collect()
    }

    fn code(decoded: &Value, key: &str) -> u16 {
        decoded[key].as_u64().unwrap() as u16
    }

    fn close(value: f64, expected: &Value) {
        assert!((value - expected.as_f64().unwrap()).abs() < 1e-9, "{value} is not {expected}");
    }

    fn scales() -> [Scale; 3] {
        [POSITION, VELOCITY, fixture()]
    }

    fn fixture() -> Scale {
        Scale::torque(0.1, 8.0)
    }

    #[test]
    fn golden_mit_commands_mean_as_documented() {
        let vectors = golden("mit", "to_motor");
        assert!(vectors.len() > 30);
        for (bytes, vector) in vectors {
            let decoded = &vector["decoded"];
            let command = MitCommand::decode(&bytes).unwrap();
            let expected = match decoded["kind"].as_str().unwrap() {
                "start_motor" => MitCommand::Start,
                "stop_motor" => MitCommand::Stop,
                "set_zero" => MitCommand::SetZero,
                "get_fault" => MitCommand::GetFault,
                "clear_fault" => MitCommand::ClearFault,
                _ => MitCommand::Control(golden_control(decoded)),
            };
            assert_eq!(command, expected, "{}", vector["name"]);
        }
    }

    fn golden_control(decoded: &Value) -> Control {
        let [position, velocity, kp, kd, torque] =
            ["pos_int", "vel_int", "kp_int", "kd_int", "torque_int"].map(|key| code(decoded, key));
        close(POSITION.value(position), &decoded["pos_rad"]);
        close(VELOCITY.value(velocity), &decoded["vel_rad_s"]);
        close(Scale::from_zero(500.0).value(kp), &decoded["kp"]);
        close(Scale::from_zero(5.0).value(kd), &decoded["kd"]);
        close(fixture().value(torque), &decoded["torque_nm"]);
        Control { position, velocity, kp, kd, torque }
    }

    fn golden_state(decoded: &Value) -> State {
        let [position, velocity, torque] = ["pos_int", "vel_int", "torque_int"].map(|key| code(decoded, key));
        let value = ["pos_rad", "vel_rad_s", "torque_nm"].map(|key| decoded[key].as_f64().unwrap());
        // The middle of a code, so that the last bit of a float has no effect.
        let middle = [(0, 25.0 / 65535.0), (1, 130.0 / 4095.0), (2, 360.0 / 4095.0)];
        let inside = middle.map(|(quantity, step)| value[quantity] + 0.5 * step);
        let state = State { position, velocity, torque };
        assert_eq!(State::encode(inside, scales(), true, BeyondRange::Clamps), state);
        assert_eq!(State::encode(value, scales(), false, BeyondRange::Clamps), state);
        state
    }

    #[test]
    fn golden_mit_states_are_sent_exactly() {
        for (bytes, vector) in golden("mit", "to_host") {
            let decoded = &vector["decoded"];
            if decoded["kind"] == "state" {
                let sent = golden_state(decoded).mit();
                assert_eq!(sent, bytes[1..6], "{}", vector["name"]);
            }
        }
    }

    #[test]
    fn golden_gim_states_are_sent_exactly() {
        let states =
            golden("gim-can", "to_host").into_iter().filter(|(_, v)| v["decoded"]["pos_int"].is_u64());
        let mut count = 0;
        for (bytes, vector) in states {
            let decoded = &vector["decoded"];
            let temperature = decoded["temperature_c"].as_i64().unwrap() as i8;
            let sent = golden_state(decoded).gim(code(decoded, "cmd") as u8, temperature);
            assert_eq!(sent, bytes[..], "{}", vector["name"]);
            count += 1;
        }
        assert!(count >= 5);
    }

    #[test]
    fn golden_gim_answers_have_result_and_data() {
        for (bytes, vector) in golden("gim-can", "to_host") {
            let decoded = &vector["decoded"];
            if decoded["pos_int"].is_u64() || decoded["res"].is_null() {
                continue;
            }
            let mut request = [0; 8];
            request[..3].copy_from_slice(&bytes[..3]);
            let result = code(decoded, "res") as u8;
            let data = match decoded["fault"].as_u64() {
                Some(fault) => [fault as u8, 0, 0, 0],
                None => bytes[4..].try_into().unwrap(),
            };
            assert_eq!(answer([0; 8], request, result, Some(data)), bytes[..], "{}", vector["name"]);
        }
    }

    #[test]
    fn golden_gim_control_commands_carry_value_and_duration() {
        for (bytes, vector) in golden("gim-can", "to_motor") {
            let decoded = &vector["decoded"];
            let Some(duration) = decoded["duration_ms"].as_u64() else { continue };
            let (value, duration_ms) = gim_control(bytes.try_into().unwrap());
            let expected =
                ["torque_nm", "speed_rpm", "position_rad"].iter().find(|key| decoded[**key].is_f64());
            close(value.into(), &decoded[*expected.unwrap()]);
            assert_eq!(u64::from(duration_ms), duration);
        }
    }

    #[test]
    fn position_beyond_range_wraps_or_clamps_alone() {
        let encode = |position, beyond| State::encode([position, 100.0, -1e9], scales(), true, beyond);
        let wrapped = encode(12.5 + 25.0 / 65535.0 * 10.5, BeyondRange::Wraps);
        assert_eq!(wrapped, State { position: 9, velocity: 4095, torque: 0 });
        assert_eq!(encode(13.0, BeyondRange::Clamps).position, 65535);
        assert_eq!(encode(-13.0, BeyondRange::Clamps).position, 0);
    }
}
