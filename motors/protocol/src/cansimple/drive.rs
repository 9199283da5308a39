//! A drive in the CANSimple dialect.
//!
//! Most commands are not answered. A stopped motor is therefore polled for the errors of its motor. Its
//! state comes from the estimates that it sends by itself, and its heartbeats tell whether it runs:
//!
//! ```text
//!   stop    axis idle, poll, axis idle, ... until a heartbeat reports idle; then polls
//!   start   mode, poll, neutral, poll, closed loop; then polls until a heartbeat reports the closed
//!           loop; then impedances
//! ```
//!
//! The request for the estimates has the id of the estimates. Both at one time destroy each other on the
//! wire, so they are requested only from a motor that does not send them by itself.
//!
//! The neutral impedance precedes the closed loop, because no source excludes that a motor executes
//! one that it stored. No source states whether an idle motor answers an impedance, so none is
//! awaited from it.
//!
//! Real-time: after [`CanSimpleDialect::new`] nothing here allocates, blocks or loops.

use super::faults::Errors;
use super::frame::{self, AxisState, Estimates, Heartbeat, Id, Reply};
use crate::drive::{
    Arrived, Command, Dialect, DriveSettings, Impedance, JointSide, Measured, MotorSide, Question, Reported,
    Shape, Status, Supply, Transmission, Unwrap,
};
use crate::mit::{Feedback, control_codes};
use crate::{Scales, StateCodes};
use motord_bus::{Duration, Frame, FrameId};

/// The last request that a state answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Asked {
    /// None.
    Nothing,
    /// An impedance.
    Impedance,
    /// The estimates of the encoder.
    Estimates,
    /// The errors of the motor, in place of a state.
    Errors,
}

/// Answered polls without an estimate after which a motor does not send them by itself: three
/// intervals at 1 kHz.
const POLLS_MAX: u8 = 30;
/// Answered polls between two requests for the estimates: estimates that arrive meanwhile end the
/// requests. Not a divisor of 10, so that the reports of the factory do not keep to the cycles of the
/// requests.
const REQUEST_INTERVAL: u8 = 7;

/// The dialect of one motor.
#[derive(Debug)]
pub struct CanSimpleDialect {
    node: u8,
    scales: Scales,
    gear_ratio: f32,
    transmission: Transmission,
    feedback: Option<Feedback>,
    unwrap: Option<Unwrap>,
    asked: Asked,
    /// Answered polls since the last estimate that was not requested, up to [`POLLS_MAX`]. A motor
    /// that is silent may send them as soon as it returns.
    polls: u8,
    /// Commands since the start or the stop began.
    step: u8,
    /// The motor is to run.
    is_started: bool,
    /// The last heartbeat; `None` since a start began without one.
    heartbeat: Option<Heartbeat>,
    errors: Errors,
    /// The last question for the supply is not answered yet.
    awaits_supply: bool,
}

impl CanSimpleDialect {
    /// Does not allocate.
    #[must_use]
    pub fn new(settings: &DriveSettings) -> Self {
        let DriveSettings { id, scales, transmission, limits, gear_ratio, .. } = *settings;
        Self {
            node: id,
            scales,
            gear_ratio,
            transmission,
            feedback: settings.error_feedback.then(|| Feedback::within(limits, &scales)),
            unwrap: settings.wraps.then(|| Unwrap::new(scales.position)),
            asked: Asked::Nothing,
            polls: 0,
            step: 0,
            is_started: false,
            heartbeat: None,
            errors: Errors::default(),
            awaits_supply: false,
        }
    }

    /// Forgets what the motor reported: it is silent, and may return after a loss of power.
    #[cold]
    fn forget(&mut self) {
        self.forget_turns();
        (self.heartbeat, self.errors, self.polls) = (None, Errors::default(), 0);
        self.set_started(false);
    }

    fn forget_turns(&mut self) {
        if let Some(unwrap) = &mut self.unwrap {
            *unwrap = Unwrap::new(self.scales.position);
        }
    }

    /// Begins a start or a stop. A heartbeat from before a start does not confirm it.
    fn set_started(&mut self, is_started: bool) {
        if self.is_started != is_started {
            (self.is_started, self.step) = (is_started, 0);
            self.heartbeat = self.heartbeat.filter(|_| !is_started);
        }
    }

    /// Returns the number of this step, and counts it.
    const fn next_step(&mut self) -> u8 {
        let step = self.step;
        self.step = step.saturating_add(1);
        step
    }

    /// Returns the next poll of a motor that does not follow impedances.
    const fn poll(&mut self) -> frame::Command {
        if self.polls < POLLS_MAX {
            return frame::Command::GetErrors;
        }
        self.polls -= REQUEST_INTERVAL;
        frame::Command::GetEstimates
    }

    /// Returns the next command to a motor that is to stop.
    fn stopping(&mut self) -> frame::Command {
        let is_idle = self.heartbeat.is_some_and(|beat| beat.state.is_idle());
        match self.next_step() {
            step if step == 0 || !is_idle && step % 2 == 0 => frame::Command::SetState(AxisState::Idle),
            // The count would stay odd.
            u8::MAX => {
                self.step = 2;
                self.poll()
            }
            _ => self.poll(),
        }
    }

    /// Returns the next command to a motor that is to start: `None` for the neutral impedance, whose
    /// answer counts.
    fn starting(&mut self) -> Option<frame::Command> {
        match self.next_step() {
            0 => Some(frame::Command::SetMode),
            2 => self.control(&Impedance::NEUTRAL),
            4 => Some(frame::Command::SetState(AxisState::ClosedLoop)),
            _ if self.is_running() => None,
            _ => Some(self.poll()),
        }
    }

    fn is_running(&self) -> bool {
        self.heartbeat.is_some_and(|beat| beat.state.is_running())
    }

    /// Returns the command for an impedance. `None` where a value is not finite.
    #[inline]
    fn control(&mut self, wanted: &Impedance<MotorSide>) -> Option<frame::Command> {
        let codes = control_codes(wanted, self.feedback.as_mut(), &self.scales);
        codes.map(frame::Command::Control)
    }

    /// Writes an impedance whose answer counts.
    #[inline]
    fn write_control(&mut self, wanted: &Impedance<MotorSide>, frame: &mut Frame) -> Option<Question> {
        let command = self.control(wanted)?;
        self.asked = Asked::Impedance;
        self.write(command, frame)?;
        Some(Question::State)
    }

    /// Writes a command to a motor that does not follow impedances.
    #[cold]
    fn write_other(&mut self, command: frame::Command, frame: &mut Frame) -> Option<Question> {
        self.write(command, frame)?;
        let (asked, question) = match command {
            frame::Command::GetEstimates => (Asked::Estimates, Question::State),
            frame::Command::GetErrors => (Asked::Errors, Question::State),
            frame::Command::GetBus => (Asked::Nothing, Question::Register),
            _ => (Asked::Nothing, Question::Unanswered),
        };
        self.asked = asked;
        Some(question)
    }

    #[inline]
    fn write(&self, command: frame::Command, frame: &mut Frame) -> Option<()> {
        let (id, payload) = command.encode(self.node);
        frame.set(FrameId::new(id.raw())?, payload);
        Some(())
    }

    /// Writes the frame of a command other than a setpoint.
    fn encode_other(&mut self, command: &Command, frame: &mut Frame) -> Option<Question> {
        let command = match command {
            Command::Nothing => {
                self.forget();
                return None;
            }
            Command::Wait | Command::GetIndicator(_) | Command::GetRegister(_) => return None,
            Command::Start | Command::Neutral => {
                self.set_started(self.is_started || matches!(command, Command::Start));
                match self.is_started.then(|| self.starting()) {
                    Some(None) => return self.write_control(&Impedance::NEUTRAL, frame),
                    Some(Some(command)) => command,
                    None => self.poll(),
                }
            }
            Command::GetFault => {
                self.write(frame::Command::GetErrors, frame)?;
                self.asked = Asked::Nothing;
                return Some(Question::Fault);
            }
            Command::GetSupply => {
                self.awaits_supply = true;
                frame::Command::GetBus
            }
            Command::ClearFault => frame::Command::ClearErrors,
            Command::SetZero => {
                self.forget_turns();
                frame::Command::SetZero
            }
            Command::Stop | Command::Control(_) => {
                self.set_started(false);
                self.stopping()
            }
        };
        self.write_other(command, frame)
    }

    /// Returns the content of a frame from this motor. `None` for estimates that no number has at the
    /// output.
    #[inline]
    fn decode(&self, arrived: Arrived<'_>) -> Option<Reply> {
        let is_formed = !arrived.id.is_extended() && arrived.format == motord_bus::Format::Classic;
        let id = Id::of(arrived.id.raw());
        let reply = Reply::decode(id, arrived.payload).filter(|_| is_formed && id.node == self.node)?;
        match reply {
            Reply::Estimates(estimates) => self.is_finite(estimates).then_some(reply),
            _ => Some(reply),
        }
    }

    fn is_finite(&self, estimates: Estimates) -> bool {
        estimates.at_output(self.gear_ratio).iter().all(|value| value.is_finite())
    }

    /// Returns whether a reply answers the last request in place of a state.
    #[inline]
    fn answers(&self, reply: &Reply) -> bool {
        matches!(
            (reply, self.asked),
            (Reply::State(_), Asked::Impedance)
                | (Reply::Estimates(_), Asked::Estimates)
                | (Reply::Errors(_), Asked::Errors)
        )
    }

    /// Returns the state, joint side, and the status.
    #[inline]
    fn state(&mut self, [position, velocity, torque]: [f32; 3]) -> (Measured<JointSide>, Status) {
        let position = self.unwrap.as_mut().map_or(position, |unwrap| unwrap.position(position));
        let motor = Measured::<MotorSide>::new(position, velocity, torque, None);
        let status = Status {
            faults: self.heartbeat.map(|_| self.errors.faults()),
            has_unnamed_fault: self.errors.is_unnamed(),
            runs: self.runs(),
        };
        (self.transmission.to_joint(&motor), status)
    }

    /// Returns whether the motor runs, by its last heartbeat. A motor that was started runs only by a
    /// heartbeat after the start.
    #[inline]
    fn runs(&self) -> Option<bool> {
        let may_run = || self.heartbeat.is_none_or(|beat| !beat.state.is_idle());
        Some(if self.is_started { self.is_running() } else { may_run() })
    }

    /// Returns the values of a state: the estimates have no torque, which is zero while stopped.
    #[inline]
    fn values(&self, reply: &Reply) -> Option<[f32; 3]> {
        match reply {
            Reply::State(codes) => Some(StateCodes::scaled(*codes, &self.scales)),
            Reply::Estimates(estimates) => Some(self.estimated(*estimates)),
            _ => None,
        }
    }

    fn estimated(&self, estimates: Estimates) -> [f32; 3] {
        let [position, velocity] = estimates.at_output(self.gear_ratio);
        let position = self.unwrap.as_ref().map_or(position, |unwrap| unwrap.wrapped(position));
        [position, velocity, 0.0]
    }
}

impl CanSimpleDialect {
    /// Takes a heartbeat. Reports faults that the last one did not have.
    fn beat(&mut self, heartbeat: Heartbeat) -> Reported {
        let before = self.errors.faults();
        self.heartbeat = Some(heartbeat);
        self.errors.beat(heartbeat);
        let faults = self.errors.faults();
        if faults.is_none() || faults == before { Reported::Unprompted } else { Reported::Fault(faults) }
    }
}

impl CanSimpleDialect {
    fn take_supply(&mut self, reply: Reply) -> Reported {
        self.awaits_supply = false;
        match reply {
            Reply::Bus { volts, amperes } => {
                Reported::Supply(Supply { voltage: volts, current: Some(amperes) })
            }
            _ => Reported::Late,
        }
    }
}

impl Dialect for CanSimpleDialect {
    #[inline]
    fn encode(&mut self, command: &Command, frame: &mut Frame) -> Option<Question> {
        // Nearly all commands are setpoints.
        if let Command::Control(setpoint) = command {
            self.is_started = true;
            let wanted = self.transmission.to_motor(&setpoint.values);
            return self.write_control(&wanted, frame);
        }
        let question = self.encode_other(command, frame);
        self.feedback.iter_mut().for_each(Feedback::forget);
        question
    }

    #[inline]
    fn classify(&self, arrived: Arrived<'_>, open: Option<Question>) -> Shape {
        match self.decode(arrived) {
            Some(Reply::State(_)) if self.asked == Asked::Impedance => Shape::Plain,
            Some(ref reply) if open == Some(Question::State) && self.answers(reply) => Shape::Plain,
            Some(Reply::Errors(_)) if open == Some(Question::Fault) => Shape::Report,
            Some(Reply::Bus { .. }) if self.awaits_supply => Shape::Register,
            Some(_) => Shape::Unprompted,
            None => Shape::Unreadable,
        }
    }

    #[inline]
    fn accept_state(&mut self, arrived: Arrived<'_>) -> Option<(Measured<JointSide>, Status)> {
        let answer = self.decode(arrived).filter(|reply| self.answers(reply));
        answer.and_then(|reply| self.values(&reply)).map(|values| self.state(values))
    }

    fn accept(&mut self, arrived: Arrived<'_>, question: Question, latency: Duration) -> Reported {
        let Some(reply) = self.decode(arrived) else { return Reported::Alive };
        if let Reply::Errors(errors) = reply {
            self.errors.record_motor(errors);
            self.polls = POLLS_MAX.min(self.polls + 1);
        }
        match self.values(&reply) {
            Some(values) => {
                let (measured, status) = self.state(values);
                Reported::State(measured, latency, status)
            }
            None if question == Question::Fault => Reported::Fault(self.errors.faults()),
            None if question == Question::Register => self.take_supply(reply),
            None => Reported::Alive,
        }
    }

    #[cold]
    fn accept_late_register(&mut self, arrived: Arrived<'_>) -> Reported {
        self.decode(arrived).map_or(Reported::Late, |reply| self.take_supply(reply))
    }

    #[cold]
    fn accept_unprompted(&mut self, arrived: Arrived<'_>) -> Reported {
        match self.decode(arrived) {
            Some(Reply::Heartbeat(heartbeat)) => self.beat(heartbeat),
            Some(Reply::Estimates(estimates)) => {
                self.polls = 0;
                if self.asked == Asked::Impedance {
                    return Reported::Unprompted;
                }
                let values = self.estimated(estimates);
                let (measured, status) = self.state(values);
                Reported::State(measured, Duration::ZERO, status)
            }
            _ => Reported::Unprompted,
        }
    }
}
