//! A drive in MyActuator's protocol.
//!
//! A motor needs no enable, so the dialect sends no impedance before the motor has answered the question
//! for its status without an error. A stop, and a silence, require another answer:
//!
//! ```text
//!            stop, silence                     start
//!   Fresh ────────────────▶ Off ─────────────────────────▶ Checking
//!                            ▲                                │ status without an error
//!                            └──── stop, silence ── Ready ◀───┘
//!
//!   Off        switch off, status, motion; then in turn angle, status, angle, switch off, angle, motion
//!   Checking   status
//!   Ready      impedances
//! ```
//!
//! An impedance in `Off` and `Checking` is sent as a stop. `Fresh` is a drive that has sent nothing: the
//! dead man's switch damps without a question.
//!
//! Real-time: after [`MyActuatorDialect::new`] nothing here allocates, blocks or loops.

use super::frame::{self, MotorStatus, Reply, number};
use crate::drive::{
    Arrived, Command, Dialect, DriveSettings, Impedance, JointSide, Measured, MotorSide, Question, Reported,
    Shape, Status, Supply, Transmission, Unwrap,
};
use crate::mit::{Feedback, control_codes};
use crate::{Scales, StateCodes};
use motord_bus::{Duration, Frame, FrameId};

/// Permission to send impedances.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Permission {
    Fresh,
    Off,
    Checking,
    Ready,
}

/// The progress of a new zero, which acts after a restart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Zero {
    Idle,
    /// It was sent.
    Sent,
    /// The motor has stored it. The next command restarts the motor.
    Stored,
}

/// Commands of a stop before the turns.
const FIRST: [frame::Command; 3] =
    [frame::Command::Stop, frame::Command::GetStatus, frame::Command::GetMotion];
/// The turns of a stopped motor: every second one reports a state. A stop may clear an error, so it
/// follows a status without one.
const TURNS: [frame::Command; 6] = [
    frame::Command::GetAngle,
    frame::Command::GetStatus,
    frame::Command::GetAngle,
    frame::Command::Stop,
    frame::Command::GetAngle,
    frame::Command::GetMotion,
];

/// The dialect of one motor.
#[derive(Debug)]
pub struct MyActuatorDialect {
    motor: u8,
    scales: Scales,
    transmission: Transmission,
    feedback: Option<Feedback>,
    unwrap: Option<Unwrap>,
    permission: Permission,
    /// First byte of the last command; 0 for an impedance. `None` where no answer is awaited.
    asked: Option<u8>,
    /// Commands since the stop began.
    step: usize,
    /// The motor confirmed the stop.
    is_off: bool,
    /// The last status has an error.
    has_error: bool,
    zero: Zero,
    /// The last reported velocity, rad/s, motor side: an angle has none. `None` since a silence; an
    /// angle is no state then.
    velocity: Option<f32>,
    /// The last reported temperature, °C: most answers have none.
    celsius: Option<f32>,
    /// The last question for the supply is not answered yet.
    awaits_supply: bool,
}

impl MyActuatorDialect {
    /// Does not allocate.
    #[must_use]
    pub fn new(settings: &DriveSettings) -> Self {
        let DriveSettings { id, scales, transmission, limits, .. } = *settings;
        Self {
            motor: id,
            scales,
            transmission,
            feedback: settings.error_feedback.then(|| Feedback::within(limits, &scales)),
            unwrap: settings.wraps.then(|| Unwrap::new(scales.position)),
            permission: Permission::Fresh,
            asked: None,
            step: 0,
            is_off: false,
            has_error: false,
            zero: Zero::Idle,
            velocity: None,
            celsius: None,
            awaits_supply: false,
        }
    }

    /// Forgets what the motor reported: it is silent, and may return after a loss of power.
    #[cold]
    fn forget(&mut self) {
        self.forget_turns();
        self.begin_stop();
        (self.step, self.is_off) = (0, false);
        (self.velocity, self.celsius) = (None, None);
    }

    fn forget_turns(&mut self) {
        self.unwrap = self.unwrap.take().map(|_| Unwrap::new(self.scales.position));
    }

    /// Withdraws the permission for impedances.
    fn begin_stop(&mut self) {
        if self.permission != Permission::Off {
            (self.permission, self.step, self.is_off) = (Permission::Off, 0, false);
        }
    }

    /// Returns the next command to a motor that is to stop. Until it has confirmed the stop, every
    /// second one is a stop.
    fn stopping(&mut self) -> frame::Command {
        if self.zero == Zero::Stored {
            (self.zero, self.step, self.is_off) = (Zero::Idle, 0, false);
            return frame::Command::Reset;
        }
        let step = self.step;
        self.step += 1;
        if let Some(first) = FIRST.get(step) {
            return *first;
        }
        let turn = (step - FIRST.len()) % TURNS.len();
        self.step = FIRST.len() + turn + 1;
        match TURNS[turn] {
            frame::Command::GetAngle => frame::Command::GetAngle,
            _ if !self.is_off => frame::Command::Stop,
            frame::Command::Stop if self.has_error => frame::Command::GetStatus,
            command => command,
        }
    }

    /// Returns the next question to a motor before its start.
    const fn poll(&mut self) -> frame::Command {
        self.step = (self.step + 1) % 2;
        if self.step == 0 { frame::Command::GetAngle } else { frame::Command::GetStatus }
    }

    /// Writes an impedance.
    #[inline]
    fn write_control(&mut self, wanted: &Impedance<MotorSide>, frame: &mut Frame) -> Option<Question> {
        let codes = control_codes(wanted, self.feedback.as_mut(), &self.scales)?;
        self.write(frame::Command::Control(codes), frame)?;
        Some(Question::State)
    }

    #[inline]
    fn write(&mut self, command: frame::Command, frame: &mut Frame) -> Option<()> {
        let (id, payload) = command.encode(self.motor);
        frame.set(FrameId::new(id)?, payload);
        self.asked = Some(command.number());
        Some(())
    }

    /// Writes the frame of a command other than an impedance with permission.
    #[cold]
    fn encode_other(&mut self, command: &Command, frame: &mut Frame) -> Option<Question> {
        let (command, question) = match command {
            Command::Nothing => {
                self.forget();
                return None;
            }
            Command::Wait | Command::GetIndicator(_) | Command::GetRegister(_) => return None,
            Command::GetFault => (frame::Command::GetStatus, Question::Fault),
            Command::GetSupply => {
                self.awaits_supply = true;
                (frame::Command::GetStatus, Question::Register)
            }
            // No source has another command that clears an error. This one "clears the state".
            Command::ClearFault => (frame::Command::Stop, Question::Clear),
            Command::SetZero => {
                self.forget_turns();
                self.zero = Zero::Sent;
                (frame::Command::SetZero, Question::State)
            }
            Command::Start | Command::Neutral => match self.permission {
                Permission::Ready => return self.write_control(&Impedance::NEUTRAL, frame),
                Permission::Off | Permission::Fresh if matches!(command, Command::Neutral) => {
                    (self.poll(), Question::State)
                }
                _ => {
                    self.permission = Permission::Checking;
                    (frame::Command::GetStatus, Question::State)
                }
            },
            Command::Stop | Command::Control(_) => {
                self.begin_stop();
                (self.stopping(), Question::State)
            }
        };
        self.write(command, frame)?;
        Some(if command == frame::Command::Reset { Question::Unanswered } else { question })
    }

    /// Returns the content of a frame from this motor.
    #[inline]
    fn decode(&self, arrived: Arrived<'_>) -> Option<Reply> {
        let is_formed = !arrived.id.is_extended() && arrived.format == motord_bus::Format::Classic;
        Reply::decode(arrived.id.raw(), arrived.payload, self.motor).filter(|_| is_formed)
    }

    /// Returns whether a frame has the content that the last command asked for.
    #[inline]
    fn answers(&self, reply: &Reply) -> bool {
        self.asked == Some(reply.number())
    }

    /// Takes position, velocity and torque, motor side. Returns them joint side.
    #[inline]
    fn state(&mut self, [position, velocity, torque]: [f32; 3]) -> (Measured<JointSide>, Status) {
        self.velocity = Some(velocity);
        let position = self.unwrap.as_mut().map_or(position, |unwrap| unwrap.position(position));
        let motor = Measured::<MotorSide>::new(position, velocity, torque, self.celsius);
        (self.transmission.to_joint(&motor), Status::default())
    }

    /// Returns the values of a state, motor side. An angle has no torque, which is zero while the drive
    /// is off.
    #[inline]
    fn values(&self, reply: &Reply) -> Option<[f32; 3]> {
        match *reply {
            Reply::State(codes) => Some(StateCodes::scaled(codes, &self.scales)),
            Reply::Angle(angle) => {
                let position = self.unwrap.as_ref().map_or(angle, |unwrap| unwrap.wrapped(angle));
                Some([position, self.velocity?, 0.0])
            }
            _ => None,
        }
    }

    /// Takes a status that answers the last command.
    fn take_status(&mut self, status: MotorStatus, question: Question) -> Reported {
        self.celsius = Some(status.celsius.into());
        let faults = status.faults();
        self.has_error = !faults.is_none();
        if question == Question::Fault || !faults.is_none() {
            return Reported::Fault(faults);
        }
        if self.permission == Permission::Checking {
            self.permission = Permission::Ready;
        }
        if question != Question::Register {
            return Reported::Alive;
        }
        self.awaits_supply = false;
        Reported::Supply(Supply { voltage: status.volts(), current: None })
    }

    /// Takes the confirmation of the last command.
    fn take_confirmation(&mut self, confirmed: u8, question: Question) -> Reported {
        if confirmed == number::SET_ZERO && self.zero == Zero::Sent {
            self.zero = Zero::Stored;
        }
        if confirmed != number::STOP {
            return Reported::Alive;
        }
        self.is_off = true;
        if question == Question::Clear { Reported::Cleared } else { Reported::Stopped }
    }
}

impl Dialect for MyActuatorDialect {
    #[inline]
    fn encode(&mut self, command: &Command, frame: &mut Frame) -> Option<Question> {
        // Nearly all commands are setpoints.
        match command {
            Command::Control(setpoint)
                if matches!(self.permission, Permission::Ready | Permission::Fresh) =>
            {
                self.write_control(&self.transmission.to_motor(&setpoint.values), frame)
            }
            _ => {
                let question = self.encode_other(command, frame);
                self.feedback.iter_mut().for_each(Feedback::forget);
                question
            }
        }
    }

    /// A status may arrive by itself, and a late answer of an earlier turn. An answer names its
    /// command, so neither is taken for another one.
    #[inline]
    fn classify(&self, arrived: Arrived<'_>, open: Option<Question>) -> Shape {
        let Some(reply) = self.decode(arrived) else { return Shape::Unreadable };
        match (reply, open) {
            (Reply::Status(_), Some(Question::Register)) => Shape::Register,
            _ if !self.answers(&reply) => match reply {
                Reply::Status(status) if self.awaits_supply && status.faults().is_none() => Shape::Register,
                _ => Shape::Unprompted,
            },
            (Reply::Status(_), None) => Shape::Unprompted,
            (Reply::Status(_), Some(Question::Fault)) => Shape::Report,
            _ => Shape::Plain,
        }
    }

    #[inline]
    fn accept_state(&mut self, arrived: Arrived<'_>) -> Option<(Measured<JointSide>, Status)> {
        let reply = self.decode(arrived).filter(|reply| self.answers(reply))?;
        let values = self.values(&reply)?;
        Some(self.state(values))
    }

    fn accept(&mut self, arrived: Arrived<'_>, question: Question, latency: Duration) -> Reported {
        let Some(reply) = self.decode(arrived) else { return Reported::Alive };
        match (reply, self.values(&reply)) {
            (_, Some(values)) => {
                let (measured, status) = self.state(values);
                Reported::State(measured, latency, status)
            }
            (Reply::Status(status), _) => self.take_status(status, question),
            (Reply::Confirmed(number), _) => self.take_confirmation(number, question),
            (Reply::Motion { celsius, velocity }, _) => {
                (self.velocity, self.celsius) = (Some(velocity), Some(celsius.into()));
                Reported::Alive
            }
            _ => Reported::Alive,
        }
    }

    #[cold]
    fn accept_late_register(&mut self, arrived: Arrived<'_>) -> Reported {
        match self.decode(arrived) {
            Some(Reply::Status(status)) => self.take_status(status, Question::Register),
            _ => Reported::Late,
        }
    }

    #[cold]
    fn accept_unprompted(&mut self, arrived: Arrived<'_>) -> Reported {
        match self.decode(arrived) {
            Some(Reply::Status(status)) if !status.faults().is_none() => Reported::Fault(status.faults()),
            _ => Reported::Unprompted,
        }
    }
}
