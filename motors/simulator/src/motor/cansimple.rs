//! The CANSimple dialect, from the motor's side: chapter 4 of SteadyWin's manual of the GIM6010-8, and
//! the vendor's SDK.
//!
//! An id is the node in the upper six bits and the command in the lower five. Values have the low byte
//! first, except those of the impedance. What the sources leave open, the driver does as follows:
//!
//! - It answers an impedance only while its axis is in closed loop.
//! - It enters the closed loop only in the control mode of impedances. It starts with the last
//!   impedance that it received.
//! - A new node id and a new zero last until the power is lost, unless it stores them.

use super::configuration::int;
use super::{Mode, Motor};
use crate::body::Law;
use crate::settings::ReplyTiming;
use crate::wire::{Control, Scale, State};
use core::f64::consts::TAU;
use motord_bus::{Frame, FrameId, Instant};

/// Ends of the codes of position, rad, velocity, rad/s, and torque, N·m.
const ENDS: [f64; 3] = [12.5, 65.0, 50.0];
/// States of the axis.
pub(super) const IDLE: u8 = 1;
pub(super) const CLOSED_LOOP: u8 = 8;
/// An error of the axis that points to the motor.
const MOTOR_FAILED: u32 = 0x40;

/// Errors of the axis, and bits of the errors of the motor, by SteadyWin's fault numbers.
const FAULTS: [(u32, u32, u64); 7] = [
    (0x01, MOTOR_FAILED, 1 << 4),
    (0x02, 0x04, 0),
    (0x04, 0x02, 0),
    (0x08, MOTOR_FAILED, 1 << 17),
    (0x10, 0x01, 0),
    (0x40, MOTOR_FAILED, 1 << 12),
    (0x80, MOTOR_FAILED, 1 << 21),
];

impl Motor {
    /// Executes a command.
    pub(super) fn cansimple(&mut self, at: Instant, frame: &Frame) -> Option<Frame> {
        let bytes = *frame.payload().first_chunk::<8>()?;
        let [low, high] = [[0, 1, 2, 3], [4, 5, 6, 7]].map(|at| u32::from_le_bytes(at.map(|at| bytes[at])));
        match frame.id().raw() & 0x1F {
            0x02 => self.raise(0x80),
            0x03 => return Some(self.node_frame(0x03, self.motor_errors().to_le_bytes())),
            0x06 => self.configuration.set_int(int::CAN_ID, low as i32 & 0x3F),
            0x07 => self.enter(low),
            0x08 => return self.impedance(at, frame),
            0x09 => return Some(self.estimates(at)),
            0x0B => self.axis.accepts_impedance = (low, high) == (3, 9),
            0x16 => self.restart(at),
            0x17 => return Some(self.node_frame(0x17, floats([self.supply, self.q_current()]))),
            0x18 => self.acknowledge(),
            0x19 => self.set_count(),
            0x1F => self.configuration.refresh(),
            _ => {}
        }
        None
    }

    /// Enters a state of the axis: idle or closed loop.
    fn enter(&mut self, state: u32) {
        let is_ready = self.axis.accepts_impedance && self.mode == Mode::Stopped;
        if state == u32::from(CLOSED_LOOP) && is_ready {
            self.mode = Mode::Running;
        } else if state == u32::from(IDLE) && self.mode == Mode::Running {
            self.mode = Mode::Stopped;
            if !self.settings.behaviour.remembers_control {
                self.law = Law::LIMP;
            }
        }
    }

    /// Follows an impedance, or only stores it while idle.
    fn impedance(&mut self, at: Instant, frame: &Frame) -> Option<Frame> {
        let law = self.law_with(Control::decode(frame.payload())?, self.output_scales());
        let before = self.coded_state(at);
        match self.mode {
            Mode::Running => self.execute(at, frame, law, Instant::FAR_FUTURE),
            Mode::Stopped if self.settings.behaviour.remembers_control => {
                self.law = law;
                return None;
            }
            _ => return None,
        }
        let state = match self.settings.behaviour.reply_timing {
            ReplyTiming::BeforeCommand => before,
            ReplyTiming::AfterCommand => self.coded_state(at),
        };
        let [a, b, c, d, e] = state.mit();
        Some(Frame::classic(self.node_id(0x08), [self.node(), a, b, c, d, e]))
    }

    fn coded_state(&mut self, at: Instant) -> State {
        let behaviour = self.settings.behaviour;
        let scales = self.output_scales();
        State::encode(self.report(at), scales, behaviour.truncates, behaviour.beyond_range)
    }

    fn output_scales(&self) -> [Scale; 3] {
        let [position, velocity, torque] = self.settings.ends.unwrap_or(ENDS);
        [(position, 65535.0), (velocity, 4095.0), (torque, 4095.0)]
            .map(|(end, codes)| Scale::symmetric(end, codes))
    }

    pub(super) fn heartbeat(&self) -> Frame {
        let errors = self.faults().fold(0, |errors, (axis, _)| errors | axis);
        let [a, b, c, d] = errors.to_le_bytes();
        let state = if self.mode == Mode::Running { CLOSED_LOOP } else { IDLE };
        let motor_flag = u8::from(errors & MOTOR_FAILED != 0);
        self.node_frame(0x01, [a, b, c, d, state, motor_flag, 0, 0])
    }

    /// Position and velocity of the rotor, in turns.
    pub(super) fn estimates(&mut self, at: Instant) -> Frame {
        let [position, velocity, _] = self.report(at);
        let turns = self.settings.gear_ratio / TAU;
        self.node_frame(0x09, floats([position * turns, velocity * turns]))
    }

    fn motor_errors(&self) -> u64 {
        self.faults().fold(0, |errors, (_, motor)| errors | motor)
    }

    /// Returns the errors of axis and motor for each fault that it has.
    fn faults(&self) -> impl Iterator<Item = (u32, u64)> {
        let fault = self.fault;
        FAULTS
            .into_iter()
            .filter(move |(number, ..)| fault & number != 0)
            .map(|(_, axis, motor)| (axis, motor))
    }

    /// Makes the present position zero until the power is lost.
    fn set_count(&mut self) {
        self.configuration.set_int(int::ZERO_POSITION, i32::from(self.encoder()));
        self.move_origin(self.body.position);
    }

    pub(super) fn restart(&mut self, at: Instant) {
        self.lose_power();
        self.boot(at);
    }

    pub(super) fn node(&self) -> u8 {
        self.configuration.int(int::CAN_ID) as u8 & 0x3F
    }

    fn node_id(&self, command: u16) -> FrameId {
        FrameId::new(u16::from(self.node()) << 5 | command).unwrap_or(FrameId::MAX)
    }

    pub(super) fn node_frame(&self, command: u16, payload: [u8; 8]) -> Frame {
        Frame::classic(self.node_id(command), payload)
    }
}

pub(super) fn floats(values: [f64; 2]) -> [u8; 8] {
    let [[a, b, c, d], [e, f, g, h]] = values.map(|value| (value as f32).to_le_bytes());
    [a, b, c, d, e, f, g, h]
}
