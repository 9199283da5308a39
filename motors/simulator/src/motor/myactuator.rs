//! MyActuator's protocol, from the motor's side: the protocol document V4.2, and the driver
//! myactuator_rmd.
//!
//! A command to motor n has the id 0x140 + n, and its answer 0x240 + n. The first byte names the command,
//! and values have the low byte first. An impedance has the id 0x400 + n, and its answer 0x500 + n. What
//! the sources leave open, the drive does as follows:
//!
//! - It repeats the payload of a command without another answer.
//! - The first impedance switches it on, and nothing else does. In fault it executes none, and answers it.
//! - It answers an impedance with the state after it, or before it, as its settings have it.
//! - A restart begins a new zero and a new id, and discards whole turns.

use super::configuration::int;
use super::{Mode, Motor};
use crate::body::Law;
use crate::settings::ReplyTiming;
use crate::wire::Control;
use motord_bus::{Frame, FrameId, Instant};

/// Ids of the frames to and from motor 0.
const COMMAND: u16 = 0x140;
const ANSWER: u16 = 0x240;
const IMPEDANCE: u16 = 0x400;
const STATE: u16 = 0x500;
/// To all motors.
const ALL: u16 = 0x280;

impl Motor {
    /// Executes a command.
    pub(super) fn myactuator(&mut self, at: Instant, frame: &Frame) -> Option<Frame> {
        let bytes = *frame.payload().first_chunk::<8>()?;
        let number = self.number();
        match frame.id().raw() as u16 {
            id if id == IMPEDANCE + number => self.motion_mode(at, frame),
            id if id == COMMAND + number || id == ALL => self.single(at, bytes),
            _ => None,
        }
    }

    /// Follows an impedance, whatever came before it.
    fn motion_mode(&mut self, at: Instant, frame: &Frame) -> Option<Frame> {
        let law = self.law_of(Control::decode(frame.payload())?);
        let before = self.state(at);
        if matches!(self.mode, Mode::Stopped | Mode::Running) {
            self.mode = Mode::Running;
            self.execute(at, frame, law, self.host_loss(at));
        }
        let state = match self.settings.behaviour.reply_timing {
            ReplyTiming::BeforeCommand => before,
            ReplyTiming::AfterCommand => self.state(at),
        };
        let [a, b, c, d, e] = state.mit();
        let number = self.number();
        Some(self.from(STATE, [number as u8, a, b, c, d, e, 0, 0]))
    }

    /// Executes a command with a number.
    fn single(&mut self, at: Instant, bytes: [u8; 8]) -> Option<Frame> {
        let answer = match bytes[0] {
            0x20 if bytes[1] == 5 => {
                self.configuration.keep_for_boot(int::CAN_ID, i32::from(bytes[4]));
                bytes
            }
            0x64 => self.store_zero(),
            0x76 => {
                self.lose_power();
                self.boot(at);
                return None;
            }
            0x80 => {
                self.switch_off();
                bytes
            }
            0x81 => bytes,
            0x92 => {
                let [position, ..] = self.report(at);
                let [a, b, c, d] = ((position.to_degrees() * 100.0).round() as i32).to_le_bytes();
                [0x92, 0, 0, 0, a, b, c, d]
            }
            0x9A => self.status_1(),
            0x9C => self.motion(at),
            0xB2 => {
                let [a, b, c, d] = self.settings.version.to_le_bytes();
                [0xB2, 0, 0, 0, a, b, c, d]
            }
            _ => return None,
        };
        Some(self.from(ANSWER, answer))
    }

    /// Temperature, brake released, voltage in 0.1 V, errors.
    fn status_1(&self) -> [u8; 8] {
        let [low, high] = ((self.supply * 10.0).round() as u16).to_le_bytes();
        let [first, second] = (self.fault as u16).to_le_bytes();
        [0x9A, self.celsius(), 0, 1, low, high, first, second]
    }

    /// Temperature, current in 0.01 A, velocity in °/s, angle in °.
    fn motion(&mut self, at: Instant) -> [u8; 8] {
        let [position, velocity, _] = self.report(at);
        let current = self.q_current() * 100.0;
        let [[a, b], [c, d], [e, f]] = [current, velocity.to_degrees(), position.to_degrees()]
            .map(|value| (value.round() as i16).to_le_bytes());
        [0x9C, self.celsius(), a, b, c, d, e, f]
    }

    fn celsius(&self) -> u8 {
        (self.body.winding.round() as i8).to_le_bytes()[0]
    }

    fn switch_off(&mut self) {
        if self.mode == Mode::Running {
            self.mode = Mode::Stopped;
        }
        self.law = Law::LIMP;
        self.control_until = Instant::FAR_FUTURE;
        self.acknowledge();
    }

    /// Keeps the present angle as the zero of the next start.
    fn store_zero(&mut self) -> [u8; 8] {
        let encoder = self.encoder();
        self.configuration.keep_for_boot(int::ZERO_POSITION, i32::from(encoder));
        let [a, b] = encoder.to_le_bytes();
        [0x64, 0, 0, 0, a, b, 0, 0]
    }

    fn number(&self) -> u16 {
        self.configuration.int(int::CAN_ID) as u16 & 0x3F
    }

    fn from(&self, base: u16, payload: [u8; 8]) -> Frame {
        Frame::classic(FrameId::new(base + self.number()).unwrap_or(FrameId::MAX), payload)
    }
}
