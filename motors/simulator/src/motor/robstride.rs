//! RobStride's private protocol, from the motor's side: the vendor's manuals of 2026-04-28, its
//! SampleProgram, and the manual of the CyberGear.
//!
//! A frame has 29 bits of id: type, 16 bits of data, receiver. Codes have 16 bits and the high byte
//! first, parameters the low byte first. The drive answers with its state, whose id has mode and
//! faults. What the documents leave open, it does as follows:
//!
//! - It answers a control frame to the host that its memory names, and any other frame to the host
//!   in that frame.
//! - It also answers in fault. A fault that no bit of a state has is reported once by a frame of
//!   type 21, after the next answer.
//! - It does not answer the commands that store parameters and that begin or end reports.

use super::configuration::int;
use super::private::index;
use super::{DelayedReply, Mode, Motor};
use crate::body::Law;
use crate::dialect::Dialect;
use crate::settings::ReplyTiming;
use crate::wire::{Scale, State};
use motord_bus::{Duration, Frame, FrameId, Instant};

/// Largest code.
const CODES: f64 = 65535.0;
/// Interval of reports from the factory.
const REPORT_PERIOD: Duration = Duration::from_millis(10);
/// Receiver of the answer to a question for the device.
const ANY: u8 = 0xFE;

impl Motor {
    /// Executes a command.
    pub(super) fn robstride(&mut self, at: Instant, frame: &Frame) -> Option<Frame> {
        let raw = frame.id().raw();
        let (kind, data) = (raw >> 24, (raw >> 8) as u16);
        let bytes = *frame.payload().first_chunk::<8>()?;
        let host = if kind == 1 { self.stored_host() } else { data as u8 };
        let before = self.wide_state(at);
        match kind {
            1 => self.follow(at, frame, data, bytes),
            3 => self.enable(),
            4 if bytes.starts_with(&[0, 0xC4]) => return Some(self.firmware(host)),
            4 => self.disable(bytes[0] == 1),
            6 if bytes[0] == 1 => self.set_zero(),
            18 => {
                let [low, high, _, _, value @ ..] = bytes;
                self.private.write(u16::from_le_bytes([low, high]), value);
            }
            _ => return self.access(kind, data, bytes),
        }
        if self.mode == Mode::Running {
            self.control_until = self.private.timeout().map_or(Instant::FAR_FUTURE, |timeout| at + timeout);
        }
        let state = match self.settings.behaviour.reply_timing {
            ReplyTiming::BeforeCommand => before,
            ReplyTiming::AfterCommand => self.wide_state(at),
        };
        Some(self.feedback(2, host, state))
    }

    /// Executes a command that is not answered by a state.
    fn access(&mut self, kind: u32, data: u16, bytes: [u8; 8]) -> Option<Frame> {
        match kind {
            0 => return Some(self.device()),
            7 => self.configuration.keep_int(int::CAN_ID, i32::from(data >> 8)),
            17 => return Some(self.parameter(data as u8, bytes)),
            22 => self.private.store(),
            24 => self.private.reports = bytes[6] == 1,
            25 => self.change_protocol(bytes[6]),
            _ => return None,
        }
        matches!(kind, 7 | 25).then(|| self.device())
    }

    /// Returns whether the drive disables itself at `due`, because no command arrived.
    pub(super) fn has_timed_out(&self, due: Instant) -> bool {
        let is_running = self.dialect() == Dialect::RobStride && self.mode == Mode::Running;
        is_running && self.control_until <= due
    }

    /// Returns a frame that the drive sends by itself at `at`, if one is due.
    pub(crate) fn take_report(&mut self, at: Instant) -> Option<DelayedReply> {
        if self.dialect() != Dialect::RobStride || !self.listens(at) {
            return None;
        }
        let frame = if self.fault != self.private.reported_fault {
            self.private.reported_fault = self.fault;
            let [a, b, c, d] = self.fault.to_le_bytes();
            self.frame(21, 0, self.stored_host(), [a, b, c, d, 0, 0, 0, 0])
        } else if self.private.reports && at >= self.private.reported_at + REPORT_PERIOD {
            self.private.reported_at = at;
            let state = self.wide_state(at);
            self.feedback(24, self.stored_host(), state)
        } else {
            return None;
        };
        Some(DelayedReply { frame, after: Duration::ZERO })
    }

    fn enable(&mut self) {
        if self.mode == Mode::Stopped {
            self.mode = Mode::Running;
        }
    }

    fn disable(&mut self, clears: bool) {
        if clears {
            self.acknowledge();
            self.private.reported_fault = self.fault;
        }
        if matches!(self.mode, Mode::Running | Mode::Calibrating) {
            self.mode = Mode::Stopped;
            self.control_until = Instant::FAR_FUTURE;
            if !self.settings.behaviour.remembers_control {
                self.law = Law::LIMP;
            }
        }
    }

    /// Follows an impedance, or only stores it while disabled.
    fn follow(&mut self, at: Instant, frame: &Frame, torque: u16, [a, b, c, d, e, f, g, h]: [u8; 8]) {
        let [position, velocity, torque_scale] = self.wide_scales();
        let [kp, kd] = self.settings.gain_ends.map(|end| Scale::from_zero(end).with_codes(CODES));
        let target = position.value(u16::from_be_bytes([a, b])) + self.origin;
        let law = Law {
            reference: target,
            target,
            rate: 0.0,
            velocity: velocity.value(u16::from_be_bytes([c, d])),
            kp: kp.value(u16::from_be_bytes([e, f])),
            kd: kd.value(u16::from_be_bytes([g, h])),
            torque: torque_scale.value(torque),
        };
        match self.mode {
            Mode::Running => self.execute(at, frame, law, Instant::FAR_FUTURE),
            Mode::Stopped if self.settings.behaviour.remembers_control => self.law = law,
            _ => {}
        }
    }

    /// Returns whether `frame` asks a RobStride drive in MIT mode for another protocol: six bytes
    /// 0xFF, the number of the protocol, and 0xFD (MIT command 8). With 0xFF it is a stop.
    pub(super) fn is_protocol_request(&self, frame: &Frame) -> bool {
        let of_drive = self.settings.vendor == "robstride";
        of_drive && matches!(*frame.payload(), [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0..=0xFE, 0xFD])
    }

    /// Stores the protocol, and answers with the serial number under the drive's own id.
    pub(super) fn change_from_mit(&mut self, frame: &Frame) -> Option<Frame> {
        self.change_protocol(*frame.payload().get(6)?);
        Some(Frame::classic(self.address(), self.serial()))
    }

    /// The protocol takes effect with the next power-on: 0 is this one, 2 is MIT.
    fn change_protocol(&mut self, number: u8) {
        let dialect = match number {
            0 => Dialect::RobStride,
            2 => Dialect::Mit,
            _ => return,
        };
        self.configuration.keep_for_boot(int::PROTOCOL, dialect.number());
    }

    /// Returns the answer to the question for a parameter: its value, or that it does not exist.
    fn parameter(&self, host: u8, [low, high, ..]: [u8; 8]) -> Frame {
        let float = |value: f64| (value as f32).to_le_bytes();
        let index = u16::from_le_bytes([low, high]);
        let value = match index {
            index::ID => Some([self.own_id(), 0, 0, 0]),
            index::HOST => Some([self.stored_host(), 0, 0, 0]),
            index::FAULTS => Some(self.fault.to_le_bytes()),
            index::POSITION => Some(float(self.position())),
            index::VELOCITY => Some(float(self.velocity())),
            index::VOLTAGE => Some(float(self.supply)),
            _ => self.private.value(index),
        };
        let failed = u8::from(value.is_none());
        let [a, b, c, d] = value.unwrap_or_default();
        self.frame(17, failed, host, [low, high, 0, 0, a, b, c, d])
    }

    /// Returns the version of the firmware in an answer of the type of a state.
    fn firmware(&self, host: u8) -> Frame {
        let [a, b, c, d] = self.settings.version.to_be_bytes();
        self.frame(2, self.status_bits(), host, [0x00, 0xC4, 0x56, a, b, c, d, 0])
    }

    /// Returns the answer with the serial number.
    fn device(&self) -> Frame {
        self.frame(0, 0, ANY, self.serial())
    }

    /// Returns the serial number, a hash (FNV-1a) of the name.
    fn serial(&self) -> [u8; 8] {
        let hash = |sum: u64, byte: &u8| (sum ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3);
        let number = self.settings.name.as_bytes().iter().fold(0xCBF2_9CE4_8422_2325, hash);
        number.to_be_bytes()
    }

    fn feedback(&self, kind: u32, host: u8, State { position, velocity, torque }: State) -> Frame {
        let temperature = (self.body.winding * 10.0).round() as i16;
        let [[a, b], [c, d], [e, f]] = [position, velocity, torque].map(u16::to_be_bytes);
        let [g, h] = temperature.to_be_bytes();
        self.frame(kind, self.status_bits(), host, [a, b, c, d, e, f, g, h])
    }

    fn frame(&self, kind: u32, status: u8, host: u8, payload: [u8; 8]) -> Frame {
        let raw = kind << 24 | u32::from(status) << 16 | u32::from(self.own_id()) << 8 | u32::from(host);
        Frame::classic(FrameId::extended(raw).unwrap_or(FrameId::MAX_EXTENDED), payload)
    }

    /// Bits 6 and 7: 0 disabled, 1 calibrating, 2 enabled. Bits 0 to 5: under-voltage, current, heat,
    /// encoder, stall, not calibrated.
    fn status_bits(&self) -> u8 {
        let mode = match self.mode {
            Mode::Running => 2,
            Mode::Calibrating => 1,
            _ => 0,
        };
        let sources = [1 << 2, 1 << 4 | 1 << 5 | 1 << 16, 1 << 0, 1 << 7, 1 << 14];
        let faults = (0..).zip(sources).filter(|(_, source)| self.fault & source != 0);
        faults.fold(mode << 6, |status, (bit, _)| status | 1 << bit)
    }

    fn own_id(&self) -> u8 {
        self.configuration.int(int::CAN_ID) as u8
    }

    fn stored_host(&self) -> u8 {
        self.configuration.int(int::HOST_ID) as u8
    }

    fn wide_scales(&self) -> [Scale; 3] {
        self.scales().map(|scale| scale.with_codes(CODES))
    }

    fn wide_state(&mut self, at: Instant) -> State {
        let behaviour = self.settings.behaviour;
        State::encode(self.report(at), self.wide_scales(), behaviour.truncates, behaviour.beyond_range)
    }
}
