//! One simulated motor: its mechanics, its drive, and its answers.

mod axis;
mod cansimple;
mod configuration;
mod gim;
mod indicator;
mod mit;
mod myactuator;
mod odrive;
mod power;
mod private;
mod registers;
mod reports;
mod robstride;

use crate::body::{Body, Law, STEP_NS, Shaft};
use crate::dialect::{Dialect, is_classic_command};
use crate::drives::AnyDrive;
use crate::fault::{Fault, InjectError};
use crate::settings::{HostLoss, Medium, MotorSettings, OtherBitrate};
use crate::wire::{POSITION, Scale, State, VELOCITY};
use configuration::{Configuration, int};
use core::f64::consts::TAU;
#[cfg(feature = "bridge")]
use motord_bus::IdFilter;
use motord_bus::{Duration, Frame, FrameId, IdSet, Instant};

/// Most steps that one call computes, 0.2 s. A longer gap takes longer steps.
const STEPS_MAX: u64 = 4_000;
/// Velocity of the shaft during a calibration, rad/s.
const CALIBRATION_VELOCITY: f64 = 1.0;

/// Error frames until a controller is error passive: each adds 8 to a counter, which must exceed
/// 127.
const DISTURBANCES: u8 = 16;

/// The mode of a drive.
///
/// ```text
///             start                  a fault
///  Stopped ----------> Running ------------------> Fault
///   | ^ ^               | stop                     | fault acknowledged,
///   | | +---------------+                          | its cause gone
///   | | +------------------------------------------+
///   | calibrate         end, stop                     (Calibrating and Stopped
///   +------------> Calibrating ----> Stopped           fall into Fault, too)
///
///  any ---- update firmware ----> Firmware        any ---- power cycle ----> Stopped
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Limp: answers, and moves nothing.
    Stopped,
    /// Executes control commands.
    Running,
    /// Limp until the fault is acknowledged.
    Fault,
    /// Turns the shaft to measure itself.
    Calibrating,
    /// Has left the bus, and waits for firmware that never arrives.
    Firmware,
}

/// A motor with its ground truth, which a real motor would not report.
#[derive(Debug, Clone)]
pub struct Motor {
    settings: MotorSettings,
    medium: Medium,
    bitrate: u32,
    configuration: Configuration,
    private: private::Memory,
    axis: axis::Axis,
    body: Body,
    /// In the body's coordinates; kept while the drive is stopped.
    law: Law,
    /// Position on the body's scale at which the motor reports zero, rad.
    origin: f64,
    mode: Mode,
    fault: u32,
    drive: AnyDrive,
    supply: f64,
    time: Instant,
    control_until: Instant,
    calibration_until: Instant,
    silent_until: Instant,
    impairment: Impairment,
    last_executed: Option<(Instant, Frame)>,
    /// The previous answer.
    last_answer: Frame,
    /// Number of frames that it can still destroy.
    disturbances: u8,
}

/// Injected faults between the drive and the wire.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Impairment {
    pub(crate) off: bool,
    /// Without power.
    dead: bool,
    /// The result code of commands that write.
    refusal: Option<u8>,
    stuck: Option<f64>,
    wrong: bool,
    slow: Option<Slow>,
    pub(crate) garbage: bool,
    pub(crate) delay: Duration,
    pub(crate) loss: f64,
    pub(crate) duplicate: bool,
    pub(crate) reorder: bool,
    pub(crate) short: bool,
}

/// A state that is reported for a while.
#[derive(Debug, Clone, Copy)]
struct Slow {
    period: Duration,
    until: Instant,
    shown: [f64; 3],
}

/// An answer, and the time that the drive needs for it in addition to its latency.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DelayedReply {
    pub(crate) frame: Frame,
    pub(crate) after: Duration,
}

impl Motor {
    pub(crate) fn new(settings: MotorSettings, medium: Medium, bitrate: u32) -> Self {
        settings.assert_physical();
        let mut motor = Self {
            configuration: Configuration::new(&settings, (medium == Medium::Can).then_some(bitrate)),
            private: private::Memory::default(),
            axis: axis::Axis::SILENT,
            body: Body::new(&settings),
            law: Law::LIMP,
            origin: 0.0,
            mode: Mode::Stopped,
            fault: 0,
            drive: AnyDrive::of(settings.vendor, settings.drive.as_ref()),
            supply: settings.supply_voltage,
            time: Instant::ZERO,
            control_until: Instant::FAR_FUTURE,
            calibration_until: Instant::FAR_FUTURE,
            silent_until: Instant::ZERO,
            impairment: Impairment { dead: !settings.has_power, ..Impairment::default() },
            last_executed: None,
            last_answer: Frame::EMPTY,
            disturbances: DISTURBANCES,
            settings,
            medium,
            bitrate,
        };
        motor.begin_reports(Instant::ZERO);
        motor
    }

    /// Returns the name in the settings.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.settings.name
    }

    /// Returns the position of the output shaft on the motor's own scale, unlimited, rad.
    #[must_use]
    pub fn position(&self) -> f64 {
        self.body.position - self.origin
    }

    /// Returns the velocity of the output shaft, rad/s.
    #[must_use]
    pub fn velocity(&self) -> f64 {
        self.body.velocity
    }

    /// Returns the torque of the drive at the output shaft, N·m.
    #[must_use]
    pub fn torque(&self) -> f64 {
        self.body.torque
    }

    /// Returns the temperature of the winding, °C.
    #[must_use]
    pub fn temperature(&self) -> f64 {
        self.body.winding
    }

    /// Returns the mode of the drive.
    #[must_use]
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Returns the vendor's fault number, in the numbering of its documents (SteadyWin: GIM
    /// document, table 9).
    #[must_use]
    pub fn fault(&self) -> u32 {
        self.fault
    }

    /// Returns the PWM frequency in effect, Hz. A written one takes effect after a reboot (GIM
    /// document, table 7).
    #[must_use]
    pub fn pwm_frequency(&self) -> i32 {
        self.configuration.pwm_frequency()
    }

    /// Returns the drive's non-volatile memory, as text: a line for each item of GIM document,
    /// table 7.
    #[must_use]
    pub fn memory(&self) -> String {
        self.configuration.memory()
    }

    /// Returns a number that differs after each change of the [`memory`](Self::memory).
    #[must_use]
    pub fn memory_revision(&self) -> u32 {
        self.configuration.revision()
    }

    /// Restarts with `memory`; `None` when it is not valid: then nothing has changed.
    pub(crate) fn remember(&mut self, memory: &str) -> Option<()> {
        self.configuration.remember(memory)?;
        self.find_turn();
        Some(())
    }

    /// Returns the last control frame that moved the motor, and its time of arrival. Frames that a
    /// stopped motor only stored do not count.
    #[must_use]
    pub fn last_executed(&self) -> Option<(Instant, Frame)> {
        self.last_executed
    }

    /// Lets a plant outside move the shaft from now on. Returns its state.
    pub(crate) fn couple(&mut self) -> Shaft {
        self.body.couple()
    }

    /// Returns the torque times time on the shaft from the last call until `to`, N·m·s.
    pub(crate) fn impulse_until(&mut self, to: Instant) -> f64 {
        self.advance(to);
        self.body.take_impulse()
    }

    /// Sets the shaft.
    ///
    /// # Panics
    ///
    /// When `shaft` is not finite.
    pub(crate) fn set_shaft(&mut self, shaft: Shaft) {
        let finite = shaft.position.is_finite() && shaft.velocity.is_finite();
        assert!(finite, "the plant set {shaft:?} for the shaft of {}", self.name());
        self.body.set_shaft(shaft);
    }

    pub(crate) fn settings(&self) -> &MotorSettings {
        &self.settings
    }

    pub(crate) fn impairment(&self) -> &Impairment {
        &self.impairment
    }

    /// Sets the start time of this motor.
    pub(crate) fn begin(&mut self, at: Instant) {
        self.time = at;
        self.begin_reports(at);
    }

    /// Moves the mechanics and the drive's own clocks up to `to`. Two expiring clocks divide this
    /// time into three spans, of at most [`STEPS_MAX`] steps each.
    pub(crate) fn advance(&mut self, to: Instant) {
        for _ in 0..2 {
            let due = self.control_until.min(self.calibration_until);
            if due > to {
                break;
            }
            self.integrate(due);
            self.reach(due.as_nanos());
            self.expire(due);
        }
        self.integrate(to);
    }

    /// Moves the mechanics to the last point of the grid that is not after `to`.
    fn integrate(&mut self, to: Instant) {
        let grid = to.as_nanos() / STEP_NS * STEP_NS;
        let next = self.time.as_nanos().next_multiple_of(STEP_NS);
        if grid < next {
            return;
        }
        self.reach(next);
        let steps = (grid - next) / STEP_NS;
        let count = steps.min(STEPS_MAX);
        let seconds = (steps * STEP_NS) as f64 / count.max(1) as f64 / 1e9;
        for _ in 0..count {
            self.step(seconds);
        }
        self.time = Instant::from_nanos(grid);
    }

    /// Moves the mechanics to the time of an event, `to`, ns, at most the next point of the grid.
    fn reach(&mut self, to: u64) {
        let nanos = to.saturating_sub(self.time.as_nanos());
        if nanos > 0 {
            self.step(nanos as f64 / 1e9);
            self.time = Instant::from_nanos(to);
        }
    }

    fn step(&mut self, seconds: f64) {
        let mut limp = Law::LIMP;
        let driven = matches!(self.mode, Mode::Running | Mode::Calibrating);
        self.body.step(if driven { &mut self.law } else { &mut limp }, seconds);
        if self.impairment.dead {
            return;
        }
        let conditions = self.conditions();
        if self.drive.raise(self.fault, conditions) != self.fault {
            self.raise(conditions);
        }
    }

    fn expire(&mut self, due: Instant) {
        if self.calibration_until <= due && self.mode == Mode::Calibrating || self.has_timed_out(due) {
            self.mode = Mode::Stopped;
        }
        self.end_control();
    }

    /// Ends the active control command or calibration: the motor is limp.
    fn end_control(&mut self) {
        self.law = Law::LIMP;
        self.control_until = Instant::FAR_FUTURE;
        self.calibration_until = Instant::FAR_FUTURE;
    }

    fn execute(&mut self, at: Instant, frame: &Frame, law: Law, until: Instant) {
        self.law = law;
        self.control_until = until;
        self.body.apply(&law);
        self.last_executed = Some((at, *frame));
    }

    /// Receives `frame` from the wire at `at`, and returns the answer, if there is one.
    pub(crate) fn receive(&mut self, at: Instant, frame: &Frame) -> Option<DelayedReply> {
        let is_register = is_classic_command(frame) && self.is_register_request(frame);
        let is_command = self.dialect().is_formed(frame) && self.commands().matches(frame.id());
        if !(is_register || is_command) || !self.listens(at) {
            return None;
        }
        self.advance(at);
        self.reach(at.as_nanos());
        let (frame, after) = match self.dialect() {
            _ if is_register => (self.register(at, frame)?, Duration::ZERO),
            Dialect::Gim => self.gim(at, frame)?,
            Dialect::Mit => (self.mit(at, frame)?, Duration::ZERO),
            Dialect::RobStride => (self.robstride(at, frame)?, Duration::ZERO),
            Dialect::CanSimple => (self.cansimple(at, frame)?, Duration::ZERO),
            Dialect::MyActuator => (self.myactuator(at, frame)?, Duration::ZERO),
            Dialect::ODrive => (self.odrive(at, frame)?, Duration::ZERO),
        };
        self.last_answer = frame;
        Some(DelayedReply { frame, after })
    }

    /// Returns the protocol that it speaks now.
    fn dialect(&self) -> Dialect {
        match self.medium {
            Medium::Serial => Dialect::Gim,
            Medium::Can => Dialect::by_number(self.configuration.int(int::PROTOCOL)),
        }
    }

    /// Returns the ids of the commands to it.
    fn commands(&self) -> IdSet {
        self.dialect().commands(self.address())
    }

    /// Returns the ids of all frames that it receives.
    #[cfg(feature = "bridge")]
    pub(crate) fn addresses(&self) -> impl Iterator<Item = IdFilter> {
        self.commands().filters().chain(self.register_requests().map(IdFilter::exact))
    }

    /// Returns `true` when it destroys a frame on a CAN bus, as a motor with another bit rate may.
    pub(crate) fn disturbs(&mut self) -> bool {
        let participates = self.medium == Medium::Can
            && self.settings.behaviour.other_bitrate == OtherBitrate::Disturbs
            && !self.configuration.listens_at(self.bitrate)
            && !self.impairment.off
            && !self.impairment.dead;
        let disturbs = participates && self.disturbances > 0;
        self.disturbances -= u8::from(disturbs);
        disturbs
    }

    /// Returns the bytes of an answer that have no meaning.
    fn filler(&self) -> [u8; 8] {
        let mut filler = [0; 8];
        if self.settings.behaviour.stale_bytes {
            let stale = self.last_answer.payload();
            filler[..stale.len()].copy_from_slice(stale);
        }
        filler
    }

    /// Sets the bit rate of the bus from now on.
    pub(crate) fn set_bitrate(&mut self, bitrate: u32) {
        self.bitrate = bitrate;
    }

    /// Returns `true` when the motor receives frames with this `id`.
    pub(crate) fn is_addressed(&self, at: Instant, id: FrameId) -> bool {
        self.listens(at) && id == self.address()
    }

    /// Returns `true` when the motor receives frames.
    fn listens(&self, at: Instant) -> bool {
        let listens = self.medium == Medium::Serial || self.configuration.listens_at(self.bitrate);
        listens
            && !self.impairment.off
            && !self.impairment.dead
            && self.mode != Mode::Firmware
            && at >= self.silent_until
    }

    pub(crate) fn address(&self) -> FrameId {
        self.line_id(int::CAN_ID)
    }

    pub(crate) fn host_address(&self) -> FrameId {
        self.line_id(int::HOST_ID)
    }

    /// Returns an id as the line carries it: 11 bits on CAN, a byte in a serial header.
    fn line_id(&self, item: u8) -> FrameId {
        let mask = if self.medium == Medium::Serial { 0xFF } else { 0x7FF };
        FrameId::new((self.configuration.int(item) & mask) as u16).unwrap_or(FrameId::MAX)
    }

    fn conditions(&self) -> u32 {
        let above = |value: f64, item| value > f64::from(self.configuration.int(item));
        let below = |value: f64, item| value < f64::from(self.configuration.int(item));
        let [over_voltage, under_voltage, over_temperature] = self.drive.conditions();
        let mut fault = 0;
        let mut raise = |number, holds: bool| {
            if holds {
                fault = self.drive.raise(fault, number);
            }
        };
        raise(over_voltage, above(self.supply, int::OVER_VOLTAGE));
        raise(under_voltage, below(self.supply, int::UNDER_VOLTAGE));
        raise(over_temperature, above(self.body.winding, int::OVER_TEMPERATURE));
        fault
    }

    fn raise(&mut self, number: u32) {
        self.fault = self.drive.raise(self.fault, number);
        if self.fault != 0 && self.mode != Mode::Firmware {
            self.mode = Mode::Fault;
            self.end_control();
        }
    }

    /// Clears the fault. A fault whose cause still holds returns immediately.
    fn acknowledge(&mut self) {
        self.fault = self.conditions();
        if self.mode == Mode::Fault && self.fault == 0 {
            self.mode = Mode::Stopped;
        }
    }

    /// Makes the present position zero. The law keeps its numbers on the motor's scale, which now
    /// mean another position.
    fn set_zero(&mut self) {
        self.configuration.keep_int(int::ZERO_POSITION, i32::from(self.encoder()));
        self.move_origin(self.body.position);
    }

    /// Discards the turns: the position is within half a turn of the stored zero.
    fn find_turn(&mut self) {
        let zero = f64::from(self.configuration.int(int::ZERO_POSITION)) * TAU / 65536.0;
        let angle = (self.body.position - zero + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0;
        self.move_origin(self.body.position - angle);
    }

    fn move_origin(&mut self, origin: f64) {
        self.law.reference += origin - self.origin;
        self.law.target += origin - self.origin;
        self.origin = origin;
    }

    /// Returns the position of the output shaft within its turn, with 65536 codes per turn (GIM
    /// document 3.2.3).
    fn encoder(&self) -> u16 {
        (self.body.position.rem_euclid(TAU) * 65536.0 / TAU) as u32 as u16
    }

    fn q_current(&self) -> f64 {
        self.body.torque / (self.settings.torque_constant * self.settings.gear_ratio)
    }

    /// Returns the scales of position, velocity and torque.
    fn scales(&self) -> [Scale; 3] {
        match self.settings.ends {
            Some([position, velocity, torque]) => [
                Scale::symmetric(position, 65535.0),
                Scale::symmetric(velocity, 4095.0),
                Scale::symmetric(torque, 4095.0),
            ],
            None => [POSITION, VELOCITY, self.torque_scale()],
        }
    }

    /// Returns the scale of torque. A SteadyWin frame carries q current, so the scale follows
    /// the motor's real constants, even if the configuration differs.
    fn torque_scale(&self) -> Scale {
        Scale::torque(self.settings.torque_constant, self.settings.gear_ratio)
    }

    /// Returns the time at which a control command received at `at` ends without another one.
    fn host_loss(&self, at: Instant) -> Instant {
        match self.settings.behaviour.host_loss {
            HostLoss::KeepsCommand => Instant::FAR_FUTURE,
            HostLoss::GoesLimp { after } => at + after,
        }
    }

    /// Returns the state as codes, changed by the injected faults.
    fn state(&mut self, at: Instant) -> State {
        let behaviour = self.settings.behaviour;
        State::encode(self.report(at), self.scales(), behaviour.truncates, behaviour.beyond_range)
    }

    fn report(&mut self, at: Instant) -> [f64; 3] {
        let position = self.impairment.stuck.unwrap_or(self.position());
        let (velocity, torque) = (self.body.velocity, self.body.torque);
        let now = if self.impairment.wrong {
            [position + 1.0, -velocity, -torque]
        } else {
            [position, velocity, torque]
        };
        let Some(slow) = &mut self.impairment.slow else { return now };
        if at >= slow.until {
            *slow = Slow { until: at + slow.period, shown: now, ..*slow };
        }
        slow.shown
    }

    /// Injects `fault` into this motor.
    pub(crate) fn inject(&mut self, at: Instant, fault: Fault) -> Result<(), InjectError> {
        self.advance(at);
        let position = self.position();
        let impairment = &mut self.impairment;
        match fault {
            Fault::Ok => self.recover(at),
            Fault::Off => impairment.off = true,
            Fault::Stuck => impairment.stuck = Some(position),
            Fault::Garbage => impairment.garbage = true,
            Fault::Wrong => impairment.wrong = true,
            Fault::Slow(period) => impairment.slow = Some(Slow { period, until: at, shown: [0.0; 3] }),
            Fault::Delayed(delay) => impairment.delay = delay,
            Fault::Intermittent(loss) => impairment.loss = loss,
            Fault::Duplicate => impairment.duplicate = true,
            Fault::Reorder => impairment.reorder = true,
            Fault::Short => impairment.short = true,
            Fault::Raise(number) => self.raise(number),
            Fault::PowerCycle => {
                self.lose_power();
                self.boot(at);
            }
            // Only the return of the power starts it.
            Fault::Restart if impairment.dead => {}
            Fault::Restart => {
                self.lose_power();
                self.boot(at);
                self.silent_until = at;
            }
            Fault::PowerOff => self.lose_power(),
            Fault::Refuse(result) => impairment.refusal = Some(result),
            Fault::Temperature(celsius) => self.body.winding = celsius,
            Fault::Voltage(volts) => self.supply = volts,
            Fault::Load(torque) => self.body.load = torque,
            _ => return Err(InjectError::NotForMotors),
        }
        Ok(())
    }

    fn recover(&mut self, at: Instant) {
        if self.impairment.dead {
            self.boot(at);
        }
        self.impairment = Impairment::default();
        self.supply = self.settings.supply_voltage;
        self.body.load = self.settings.load_torque;
    }
}
