//! The native GIM protocol, from the motor's side (GIM document 3.2).

use super::configuration::{int, rpm};
use super::{CALIBRATION_VELOCITY, Mode, Motor};
use crate::body::Law;
use crate::settings::{DurationEnd, InFault, ReplyTiming};
use crate::wire::{self, command, result};
use motord_bus::{Duration, Frame, Instant};

/// Time constant of the speed loop, s. The gains have no documented unit, so the loops are fixed
/// and well tuned.
const SPEED_LOOP: f64 = 0.002;
/// Corner of the critically damped position loop, rad/s.
const POSITION_LOOP: f64 = 60.0;

impl Motor {
    /// Returns the answer, and the time that the motor is busy before it.
    pub(super) fn gim(&mut self, at: Instant, frame: &Frame) -> Option<(Frame, Duration)> {
        // A change of id or protocol takes effect after its own answer.
        let host_id = self.host_address();
        let (payload, after) = self.answer_gim(at, frame, frame.payload().try_into().ok()?)?;
        Some((Frame::classic(host_id, payload), after))
    }

    fn answer_gim(&mut self, at: Instant, frame: &Frame, bytes: [u8; 8]) -> Option<([u8; 8], Duration)> {
        let now = |payload| Some((payload, Duration::ZERO));
        let refused = |motor: &Self, result| now(motor.plain(bytes, result));
        match (self.mode, bytes[0]) {
            (_, command::GET_FAULT | command::ACKNOWLEDGE_FAULT) => now(self.status(bytes)),
            (Mode::Fault, _) if self.settings.behaviour.in_fault == InFault::Silent => None,
            (Mode::Fault, _) => refused(self, result::FAILURE),
            (
                Mode::Calibrating,
                0x81..=0x91 | 0x93..=0xA1 | command::CALIBRATE | command::UPDATE_FIRMWARE,
            ) => refused(self, result::FAILURE),
            (_, command) if is_write(command) && self.impairment.refusal.is_some() => {
                refused(self, self.impairment.refusal.unwrap_or(result::FAILURE))
            }
            (_, command::TORQUE | command::SPEED | command::POSITION) => now(self.control(at, frame, bytes)),
            (_, command::CALIBRATE) => Some(self.calibrate(at, bytes)),
            (_, command::UPDATE_FIRMWARE) => {
                self.end_control();
                self.mode = Mode::Firmware;
                None
            }
            _ => now(self.status(bytes)),
        }
    }

    /// Returns an answer without data.
    fn plain(&self, request: [u8; 8], result: u8) -> [u8; 8] {
        wire::answer(self.filler(), request, result, None)
    }

    /// Executes commands whose answer is a result and perhaps data.
    fn status(&mut self, bytes: [u8; 8]) -> [u8; 8] {
        let (code, data) = match self.perform(bytes) {
            Ok(data) => (result::SUCCESS, data),
            Err(code) => (code, None),
        };
        wire::answer(self.filler(), bytes, code, data)
    }

    /// Returns the data of the answer, if it has some, or a result code.
    fn perform(&mut self, [command, sub, id, _, data @ ..]: [u8; 8]) -> Result<Option<[u8; 4]>, u8> {
        match command {
            command::RESET_CONFIGURATION => self.reset_configuration(),
            command::REFRESH_CONFIGURATION => self.configuration.refresh(),
            command::MODIFY_CONFIGURATION => self.modify_configuration(sub, id, data)?,
            command::RETRIEVE_CONFIGURATION => return self.configuration.retrieve(sub, id).map(Some),
            command::START => self.mode = Mode::Running,
            command::STOP => {
                self.end_control();
                self.mode = Mode::Stopped;
            }
            command::STOP_CONTROL => self.end_control(),
            command::MODIFY_PARAMETER => self.configuration.modify_parameter(sub, data)?,
            command::RETRIEVE_PARAMETER => return self.configuration.parameter(sub).map(Some),
            command::GET_VERSION => return Ok(Some(self.settings.version.to_le_bytes())),
            command::GET_FAULT => return Ok(Some([self.fault as u8, 0, 0, 0])),
            command::ACKNOWLEDGE_FAULT => self.acknowledge(),
            command::RETRIEVE_INDICATOR => {
                let value = self.indicator(sub).ok_or(result::UNKNOWN_REGISTER)?;
                return Ok(Some(value.to_le_bytes()));
            }
            _ => return Err(result::UNKNOWN_COMMAND),
        }
        Ok(None)
    }

    fn reset_configuration(&mut self) {
        self.configuration.reset(&self.settings);
        self.find_turn();
    }

    fn modify_configuration(&mut self, kind: u8, id: u8, data: [u8; 4]) -> Result<(), u8> {
        self.configuration.modify(kind, id, data)?;
        if (kind, id) == (0x00, int::ZERO_POSITION) {
            self.find_turn();
        }
        Ok(())
    }

    fn control(&mut self, at: Instant, frame: &Frame, bytes: [u8; 8]) -> [u8; 8] {
        let (value, duration_ms) = wire::gim_control(bytes);
        if !value.is_finite() {
            return self.plain(bytes, result::DATA_FORMAT);
        }
        if self.mode != Mode::Running {
            return self.plain(bytes, result::FAILURE);
        }
        let before = self.state(at);
        let duration = Duration::from_millis(u64::from(duration_ms));
        let law = match bytes[0] {
            command::TORQUE => self.torque_law(value.into()),
            command::SPEED => self.speed_law(value.into()),
            _ => self.position_law(value.into(), duration),
        };
        let ends = duration_ms > 0 && self.settings.behaviour.duration_end == DurationEnd::GoesLimp;
        let until = if ends { at + duration } else { Instant::FAR_FUTURE };
        self.execute(at, frame, law, until);
        let state = match self.settings.behaviour.reply_timing {
            ReplyTiming::BeforeCommand => before,
            ReplyTiming::AfterCommand => self.state(at),
        };
        state.gim(bytes[0], self.temperature_byte())
    }

    /// Returns the law for a torque. The drive converts N·m to a current by its configured
    /// constants. The motor converts the current to torque by its real ones.
    fn torque_law(&self, torque: f64) -> Law {
        let real = self.settings.torque_constant * self.settings.gear_ratio;
        let configured =
            self.configuration.torque_constant() * f64::from(self.configuration.int(int::GEAR_RATIO));
        Law { torque: torque * real / configured, ..Law::LIMP }
    }

    pub(super) fn speed_law(&self, speed_rpm: f64) -> Law {
        let velocity = (speed_rpm / rpm(1.0)).clamp(-self.speed_max(), self.speed_max());
        Law { velocity, kd: self.body.inertia() / SPEED_LOOP, ..Law::LIMP }
    }

    /// Returns the law for a position. The reference arrives after `duration`, or moves at the
    /// highest speed when that takes longer. It continues from the reference of the previous
    /// target. If it started at the shaft, it would slow down a controller that streams its
    /// targets.
    pub(super) fn position_law(&self, position: f64, duration: Duration) -> Law {
        let target = position + self.origin;
        let reference = if self.law.kp > 0.0 { self.law.reference } else { self.body.position };
        let distance = (target - reference).abs();
        let inertia = self.body.inertia();
        Law {
            reference,
            target,
            rate: (distance / duration.as_secs_f64()).min(self.speed_max()),
            kp: inertia * POSITION_LOOP * POSITION_LOOP,
            kd: 2.0 * inertia * POSITION_LOOP,
            ..Law::LIMP
        }
    }

    /// Returns the configured highest speed, rad/s.
    fn speed_max(&self) -> f64 {
        f64::from(self.configuration.int(int::SPEED_MAX_RPM)) / rpm(1.0)
    }

    fn calibrate(&mut self, at: Instant, bytes: [u8; 8]) -> ([u8; 8], Duration) {
        if bytes[1] > 0x01 {
            return (self.plain(bytes, result::UNKNOWN_REGISTER), Duration::ZERO);
        }
        if self.mode != Mode::Stopped {
            return (self.plain(bytes, result::FAILURE), Duration::ZERO);
        }
        let duration = self.settings.calibration_time;
        self.mode = Mode::Calibrating;
        self.calibration_until = at + duration;
        self.law = Law { velocity: CALIBRATION_VELOCITY, kd: self.body.inertia() / SPEED_LOOP, ..Law::LIMP };
        (self.plain(bytes, result::SUCCESS), duration)
    }

    /// Returns the temperature in an answer, °C: that of the winding, the hottest part.
    fn temperature_byte(&self) -> i8 {
        self.body.winding.floor() as i8
    }
}

/// Returns `true` when the command changes the motor's memory.
fn is_write(command: u8) -> bool {
    matches!(
        command,
        command::RESET_CONFIGURATION
            | command::REFRESH_CONFIGURATION
            | command::MODIFY_CONFIGURATION
            | command::MODIFY_PARAMETER
            | command::CALIBRATE
    )
}
