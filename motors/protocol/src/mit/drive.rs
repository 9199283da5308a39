//! A drive in MIT mode. Source: MIT document.
//!
//! Real-time: after [`MitDialect::new`] nothing here allocates, blocks or loops.

use super::control_codes;
use super::feedback::Feedback;
use super::{Asked, Reply, State};
use crate::drive::{
    Arrived, Command, Dialect, DriveSettings, Impedance, JointSide, Measured, MotorSide, Question, Reported,
    Shape, Status, Transmission, Unwrap,
};
use crate::{Faults, Profile, Scales, register};
use motord_bus::{Duration, Frame, FrameId, Instant};

/// The dialect of one motor in MIT mode.
#[derive(Debug)]
pub struct MitDialect {
    id: u8,
    command_id: FrameId,
    profile: &'static Profile,
    scales: Scales,
    transmission: Transmission,
    feedback: Option<Feedback>,
    unwrap: Option<Unwrap>,
    /// Largest velocity of the joint, rad/s, and its largest torque, N·m.
    limits: [f32; 2],
    /// The last accepted state.
    last: Option<Last>,
    /// A state had a status since the motor was silent: one without is that of a motor that is off.
    has_status: bool,
    /// The last answer to a fault request, if it may be a late state.
    ambiguous: Option<Ambiguous>,
}

/// After a longer silence no reply answers an earlier request.
const SILENCE_MAX: Duration = Duration::from_millis(100);
/// Codes are coarse, and a stopped joint can be pushed: rad and rad/s.
const POSITION_MARGIN: f32 = 0.05;
const VELOCITY_MARGIN: f32 = 15.0;

/// The state that the next is compared with.
#[derive(Debug, Clone, Copy)]
struct Last {
    /// rad.
    position: f32,
    /// rad/s.
    velocity: f32,
    at: Instant,
}

impl Last {
    const fn of(state: &State, at: Instant) -> Self {
        Self { position: state.position, velocity: state.velocity, at }
    }
}

/// A payload that may be a fault report or a state. The faults count when the next answer to a
/// fault request has the same ones, and until then no reply is late and no state continues this
/// one.
#[derive(Debug, Clone, Copy)]
struct Ambiguous {
    /// Read as a fault report.
    faults: Faults,
    /// Read as a state.
    state: Option<Last>,
}

impl MitDialect {
    /// Does not allocate.
    #[must_use]
    pub fn new(settings: &DriveSettings) -> Self {
        let DriveSettings { id, profile, scales, transmission, limits, .. } = *settings;
        Self {
            id,
            command_id: FrameId::from(id),
            profile,
            scales,
            transmission,
            feedback: settings.error_feedback.then(|| Feedback::within(limits, &scales)),
            unwrap: settings.wraps.then(|| Unwrap::new(scales.position)),
            limits,
            last: None,
            has_status: false,
            ambiguous: None,
        }
    }

    /// Writes the request for the register with this number; `None` where the motor has none.
    #[cold]
    fn read_register(&self, number: u8, frame: &mut Frame) -> Option<Question> {
        let register = register::ENDS.get(usize::from(number)).filter(|_| self.profile.has_registers)?;
        frame.set(FrameId::new(register::REQUEST_ID)?, register::read(self.id, *register));
        Some(Question::Register)
    }

    /// Returns whether the motor answers a question for its faults. Otherwise its states contain
    /// them.
    const fn answers_fault_question(&self) -> bool {
        self.profile.is_asked_for_faults()
    }

    /// Resets the count of turns: the motor is silent, or its zero changes.
    fn forget_turns(&mut self) {
        if let Some(unwrap) = &mut self.unwrap {
            *unwrap = Unwrap::new(self.scales.position);
        }
    }

    /// Writes the frame of a command other than a setpoint.
    #[inline(never)]
    fn encode_other(&mut self, command: &Command, frame: &mut Frame) -> Option<Question> {
        let (command, question) = match command {
            Command::Nothing => {
                self.forget_turns();
                // It may return with another firmware.
                self.has_status = false;
                return None;
            }
            Command::Wait | Command::GetIndicator(_) | Command::GetSupply => return None,
            Command::GetRegister(number) => return self.read_register(*number, frame),
            Command::Stop => (super::Command::Stop, Question::State),
            Command::Start => (super::Command::Start, Question::State),
            Command::SetZero => {
                self.forget_turns();
                (super::Command::SetZero, Question::State)
            }
            Command::GetFault if self.answers_fault_question() => (super::Command::GetFault, Question::Fault),
            // Such a motor may take the question for a control frame of full stiffness (protocol
            // note M17).
            Command::GetFault => (super::Command::Stop, Question::State),
            Command::ClearFault => (super::Command::ClearFault, Question::Clear),
            Command::Neutral | Command::Control(_) => return self.encode_impedance(command, frame),
        };
        if let Some(feedback) = &mut self.feedback {
            feedback.forget();
        }
        frame.set(self.command_id, self.profile.encode(&command, &self.scales).ok()?);
        Some(question)
    }

    /// The impedance of a command that has one; neutral for any other command.
    #[inline(always)]
    fn wanted(&self, command: &Command) -> Impedance<MotorSide> {
        match command {
            Command::Control(setpoint) => self.transmission.to_motor(&setpoint.values),
            _ => Impedance::NEUTRAL,
        }
    }

    /// Writes the control frame for the impedance of a command. `None` where a value is not finite.
    #[inline(always)]
    fn encode_impedance(&mut self, command: &Command, frame: &mut Frame) -> Option<Question> {
        let wanted = self.wanted(command);
        let codes = control_codes(&wanted, self.feedback.as_mut(), &self.scales)?;
        frame.set(self.command_id, codes.pack());
        Some(Question::State)
    }

    /// Returns whether the payload, read as a state, continues the motion.
    #[cold]
    fn may_continue(&self, payload: &[u8], at: Instant) -> bool {
        let Ok(state) = self.profile.decode_state(payload, &self.scales) else { return false };
        self.last.is_some_and(|last| self.follows(last, Last::of(&state, at)))
    }

    /// Returns whether the motor can have reached `state` since `last`. False after a long silence.
    fn follows(&self, last: Last, state: Last) -> bool {
        let silence = state.at.since(last.at);
        let reach = self.scales.velocity.max() as f32 * silence.as_secs_f32() + POSITION_MARGIN;
        silence <= SILENCE_MAX
            && (state.position - last.position).abs() < reach
            && (state.velocity - last.velocity).abs() < VELOCITY_MARGIN
    }

    /// Stores `state` as the newest, and returns it joint side.
    #[inline(always)]
    fn state(&mut self, state: &State, at: Instant) -> (Measured<JointSide>, Status) {
        let last = Last::of(state, at);
        self.last = Some(last);
        if self.ambiguous.is_some() {
            self.compare_ambiguous(last);
        }
        let position = self.unwrap.as_mut().map_or(state.position, |unwrap| unwrap.position(state.position));
        let motor = Measured::new(position, state.velocity, state.torque, state.hottest());
        let status = Status {
            faults: self.profile.faults_of(state),
            has_unnamed_fault: self.profile.has_unnamed_fault(state),
            runs: self.runs(state),
        };
        (self.transmission.to_joint(&motor), status)
    }

    /// Returns whether the motor reports that it is enabled; `None` where its states have no
    /// status. All bits of a status are zero when a motor is off and has no fault, as in a state of
    /// firmware without a status.
    #[inline(always)]
    fn runs(&mut self, state: &State) -> Option<bool> {
        let runs = self.profile.is_on(state);
        self.has_status |= runs.is_some();
        let is_off = self.has_status && state.status.is_none();
        runs.or(is_off.then_some(false))
    }

    /// Forgets an ambiguous answer that `state` continues: it was a state.
    #[cold]
    fn compare_ambiguous(&mut self, state: Last) {
        let before = self.ambiguous.and_then(|ambiguous| ambiguous.state);
        if before.is_some_and(|before| self.follows(before, state)) {
            self.refute();
        }
    }

    /// Returns the faults in a fault report.
    fn faults_in(&self, payload: &[u8]) -> Option<Faults> {
        match self.profile.decode(payload, Asked::Fault, &self.scales) {
            Ok(Reply::Fault { faults, .. }) => Some(faults),
            _ => None,
        }
    }
}

impl Dialect for MitDialect {
    #[inline(always)]
    fn encode(&mut self, command: &Command, frame: &mut Frame) -> Option<Question> {
        // Nearly all commands are setpoints.
        match command {
            Command::Control(_) => self.encode_impedance(command, frame),
            _ => self.encode_other(command, frame),
        }
    }

    #[inline(always)]
    fn classify(&self, arrived: Arrived<'_>, open: Option<Question>) -> Shape {
        let Arrived { payload, at, .. } = arrived;
        if !payload.is_empty() && !self.profile.is_from(self.id, payload) {
            return Shape::OtherId;
        }
        if self.profile.has_registers && register::is_answer(self.id, payload) {
            return Shape::Register;
        }
        if self.profile.is_fault_report(payload) {
            return Shape::Report;
        }
        if !self.profile.fits_state(payload) {
            return Shape::Unreadable;
        }
        match open == Some(Question::Fault) && self.may_continue(payload, at) {
            true => Shape::Continuation,
            false => Shape::Plain,
        }
    }

    #[inline(always)]
    fn accept_state(&mut self, arrived: Arrived<'_>) -> Option<(Measured<JointSide>, Status)> {
        let Arrived { payload, at, .. } = arrived;
        let is_plain = self.classify(arrived, Some(Question::State)) == Shape::Plain;
        let state = self.profile.decode_state(payload, &self.scales).ok().filter(|_| is_plain)?;
        Some(self.state(&state, at))
    }

    fn accept(&mut self, arrived: Arrived<'_>, question: Question, latency: Duration) -> Reported {
        let Arrived { payload, at, .. } = arrived;
        match question {
            Question::State => match self.profile.decode_state(payload, &self.scales) {
                Ok(state) => {
                    let (measured, status) = self.state(&state, at);
                    Reported::State(measured, latency, status)
                }
                Err(_) => Reported::Alive,
            },
            Question::Fault => {
                self.refute();
                self.faults_in(payload).map_or(Reported::Alive, Reported::Fault)
            }
            Question::Register => match register::end_of(self.id, payload) {
                Some((number, value)) => Reported::Register(number as u8, value),
                None => Reported::Alive,
            },
            Question::Clear => Reported::Cleared,
            Question::Unanswered => Reported::Alive,
        }
    }

    fn accept_ambiguous(&mut self, arrived: Arrived<'_>) -> Reported {
        let Arrived { payload, at, .. } = arrived;
        let Some(faults) = self.faults_in(payload) else { return Reported::Alive };
        if self.ambiguous.take().is_some_and(|before| before.faults == faults) {
            return Reported::Fault(faults);
        }
        let state = self.profile.decode_state(payload, &self.scales).ok();
        let state = state.map(|state| Last::of(&state, at));
        self.ambiguous = Some(Ambiguous { faults, state });
        Reported::Ambiguous(faults)
    }

    fn accept_late_register(&mut self, arrived: Arrived<'_>) -> Reported {
        self.refute();
        let value = register::end_of(self.id, arrived.payload);
        value.map_or(Reported::Late, |(number, value)| Reported::LateRegister(number as u8, value))
    }

    fn refute(&mut self) {
        self.ambiguous = None;
    }

    fn use_ends(&mut self, ends: [f32; 3]) {
        let scales = self.scales.with_ends(ends);
        if scales == self.scales {
            return;
        }
        self.scales = scales;
        self.last = None;
        if let Some(feedback) = &mut self.feedback {
            *feedback = Feedback::within(self.limits, &scales);
        }
        self.forget_turns();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::{JointSide, Setpoint};
    use crate::execution_time::ExecutionTime;
    use crate::mit::decode_command;
    use crate::profile::STEADYWIN;

    /// Of the GIM8108-8, by the MIT document 1.1.
    fn scales() -> Scales {
        Scales::by_current(0.125, 8.0).unwrap()
    }

    /// Goal: damping alone does not push a joint. Zero lies half a code of velocity off, which is
    /// 32 mN·m with this damping. Method: the mean torque of 1 000 frames of a GIM8108-8 at rest,
    /// by the law of the drive.
    #[test]
    fn damping_at_rest_has_no_mean_torque() {
        let settings = DriveSettings {
            id: 1,
            host_id: FrameId::from(0x11),
            profile: &STEADYWIN,
            scales: scales(),
            gear_ratio: 8.0,
            transmission: Transmission::new(1.0, 0.0),
            limits: [12.0, 8.0],
            wraps: false,
            duration: ExecutionTime::MAX,
            error_feedback: true,
        };
        let mut drive = MitDialect::new(&settings);
        for velocity in [0.0, 0.7, -3.3] {
            let damping = Setpoint::impedance(Impedance::<JointSide>::new(0.0, velocity, 0.0, 2.0, 0.0));
            let mut sum = 0.0;
            for _ in 0..1000 {
                let mut frame = Frame::classic(FrameId::new(1).unwrap(), [0; 8]);
                drive.encode(&Command::Control(damping), &mut frame).unwrap();
                let Ok(crate::mit::Command::Control(sent)) = decode_command(frame.payload(), &scales())
                else {
                    panic!("{frame:?} is no control frame");
                };
                sum += 2.0 * f64::from(sent.velocity - velocity) + f64::from(sent.torque);
            }
            assert!(f64::abs(sum / 1000.0) < 2e-4, "{velocity} rad/s: {} N·m", sum / 1000.0);
        }
    }
}
