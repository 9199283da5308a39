//! A drive in MIT mode. Source: MIT document.
//!
//! Real-time: after [`Mit::new`] nothing here allocates, blocks or loops.

use super::correlator::{Payload, Question};
use crate::control::{Command, Reported, Status};
use crate::joint::{Impedance, Measured, MotorSide, Transmission};
use crate::settings::{BeyondRange, MotorSettings};
use motord_bus::{Duration, Frame, FrameId, Instant};
use motord_protocol::mit::{self, Asked, ControlCodes, Reply, State};
use motord_protocol::{Ends, Faults, Field, Profile, Scales, register};

#[derive(Debug)]
pub(super) struct Mit {
    id: u8,
    profile: &'static Profile,
    scales: Scales,
    transmission: Transmission,
    feedback: Option<Feedback>,
    unwrap: Option<Unwrap>,
    /// Largest torque of the joint, N·m.
    torque_max: f32,
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

/// A payload that may be a fault report or a state. The faults count when the next answer to a fault request has the same ones,
/// and until then no reply is late and no state continues this one.
#[derive(Debug, Clone, Copy)]
struct Ambiguous {
    /// Read as a fault report.
    faults: Faults,
    /// Read as a state.
    state: Option<Last>,
}

/// Follows a position whose code wraps round. The turns are counted from accepted states only.
#[derive(Debug)]
struct Unwrap {
    /// The span of all position codes, rad: a position that leaves the range comes back this far away.
    period: f32,
    turns: f32,
    last: Option<f32>,
}

impl Unwrap {
    /// Of positions with these 65536 codes.
    fn new(position: Field) -> Self {
        Self { period: (65536.0 * position.step()) as f32, turns: 0.0, last: None }
    }

    /// Returns the position over any number of turns, rad. A step of more than half the range is a
    /// wrap.
    fn position(&mut self, reported: f32) -> f32 {
        let step = reported - self.last.unwrap_or(reported);
        if step.abs() > self.period / 2.0 {
            self.turns -= step.signum();
        }
        self.last = Some(reported);
        reported + self.turns * self.period
    }
}

/// Carries the rounding error of the torque code from frame to frame, so that the mean of the codes is the torque asked
/// for: zero lies half a code off, and a code is up to 0.3 N·m.
#[derive(Debug)]
struct Feedback {
    /// The sum that the frames so far sent too much, in codes; within ±0.5.
    carried: f64,
    /// The lowest and highest code within the joint's torque limit.
    codes: [f64; 2],
}

impl Mit {
    pub(super) fn new(settings: &MotorSettings, error_feedback: bool) -> Self {
        let scales = settings.scales;
        Self {
            id: settings.id,
            profile: settings.profile,
            scales,
            transmission: settings.transmission,
            feedback: error_feedback.then(|| Feedback::within(settings.limits.torque, &scales)),
            unwrap: (settings.beyond_range == BeyondRange::Wrap).then(|| Unwrap::new(scales.position)),
            torque_max: settings.limits.torque,
            last: None,
            has_status: false,
            ambiguous: None,
        }
    }

    /// Writes the frame for `command`; `None` for [`Command::Nothing`] and [`Command::Wait`]. Constant time.
    #[inline(always)]
    pub(super) fn encode(&mut self, command: &Command, id: FrameId, frame: &mut Frame) -> Option<()> {
        let command = match command {
            Command::Nothing => {
                self.forget_turns();
                // It may return with another firmware.
                self.has_status = false;
                return None;
            }
            Command::Wait | Command::GetIndicator(_) => return None,
            Command::GetRegister(number) => return self.read_register(*number, frame),
            Command::Stop => mit::Command::Stop,
            Command::Start => mit::Command::Start,
            Command::SetZero => {
                self.forget_turns();
                mit::Command::SetZero
            }
            Command::GetFault if self.answers_fault_question() => mit::Command::GetFault,
            // Such a motor may take the question for a control frame of full stiffness (protocol note M17).
            Command::GetFault => mit::Command::Stop,
            Command::ClearFault => mit::Command::ClearFault,
            Command::Neutral | Command::Control(_) => {
                let wanted = self.wanted(command);
                frame.set(id, self.codes(&wanted)?.pack());
                return Some(());
            }
        };
        if let Some(feedback) = &mut self.feedback {
            feedback.carried = 0.0;
        }
        frame.set(id, command.encode(&self.scales).ok()?);
        Some(())
    }

    /// Writes the request for the register with this number; `None` where the motor has none.
    #[cold]
    fn read_register(&self, number: u8, frame: &mut Frame) -> Option<()> {
        let register = register::ENDS.get(usize::from(number)).filter(|_| self.profile.has_registers)?;
        frame.set(FrameId::new(register::REQUEST_ID)?, register::read(self.id, *register));
        Some(())
    }

    /// Uses these ends of the codes from now on. The gains keep theirs, which no register contains.
    pub(super) fn use_ends(&mut self, [position, velocity, torque]: [f32; 3]) {
        let [position, velocity, torque] = [position, velocity, torque].map(f64::from);
        let scales = Scales::of(&Ends { position, velocity, torque, ..self.scales.ends() });
        if scales == self.scales {
            return;
        }
        self.scales = scales;
        self.last = None;
        if let Some(feedback) = &mut self.feedback {
            *feedback = Feedback::within(self.torque_max, &scales);
        }
        self.forget_turns();
    }

    /// Returns whether the motor answers a question for its faults. Otherwise its states contain
    /// them.
    pub(super) const fn answers_fault_question(&self) -> bool {
        self.profile.is_asked_for_faults()
    }

    /// Resets the count of turns: the motor is silent, or its zero changes.
    fn forget_turns(&mut self) {
        if let Some(unwrap) = &mut self.unwrap {
            *unwrap = Unwrap::new(self.scales.position);
        }
    }

    /// The impedance of a command that has one; neutral for any other command.
    fn wanted(&self, command: &Command) -> Impedance<MotorSide> {
        match command {
            Command::Control(setpoint) => self.transmission.to_motor(&setpoint.values),
            _ => Impedance::NEUTRAL,
        }
    }

    /// The control codes for an impedance, clamped to the ranges of the codes.
    #[inline(always)]
    fn codes(&mut self, wanted: &Impedance<MotorSide>) -> Option<ControlCodes> {
        // Without stiffness the position has no effect, so it is sent as zero: 0x80, the first byte
        // of zero, is no GIM command, if this motor has left MIT mode (protocol note 1.3).
        let position = if wanted.kp > 0.0 { wanted.position } else { 0.0 };
        let Impedance { velocity, kp, kd, torque, .. } = *wanted;
        if !torque.is_finite() {
            return None;
        }
        let wanted = mit::Impedance { position, velocity, kp, kd, torque };
        let codes = match &mut self.feedback {
            Some(feedback) => {
                let torque = feedback.quantise(torque, &self.scales);
                ControlCodes::nearest_with_torque(&wanted, torque, &self.scales)
            }
            None => ControlCodes::nearest(&wanted, &self.scales),
        };
        codes.ok()
    }

    /// Returns whether the payload, read as a state, continues the motion.
    #[cold]
    fn may_continue(&self, payload: &[u8], at: Instant) -> bool {
        self.profile.decode_state(payload, &self.scales).is_ok_and(|state| self.continues(&state, at))
    }

    /// Returns whether the motor can have reached `state` since its last accepted state.
    fn continues(&self, state: &State, at: Instant) -> bool {
        self.last.is_some_and(|last| self.follows(last, state, at))
    }

    /// Returns whether the motor can have reached `state` since `last`. False after a long silence.
    fn follows(&self, last: Last, state: &State, at: Instant) -> bool {
        let silence = at.since(last.at);
        let reach = self.scales.velocity.max() as f32 * silence.as_secs_f32() + POSITION_MARGIN;
        silence <= SILENCE_MAX
            && (state.position - last.position).abs() < reach
            && (state.velocity - last.velocity).abs() < VELOCITY_MARGIN
    }

    /// Stores `state` as the newest, and returns it joint side.
    #[inline(always)]
    fn state(&mut self, state: &State, at: Instant, latency: Duration) -> Reported {
        self.last = Some(Last { position: state.position, velocity: state.velocity, at });
        if self.ambiguous.is_some() {
            self.compare_ambiguous(state, at);
        }
        let position = self.unwrap.as_mut().map_or(state.position, |unwrap| unwrap.position(state.position));
        let motor = Measured::new(position, state.velocity, state.torque, state.hottest());
        let status = Status {
            faults: self.profile.faults_of(state),
            has_unnamed_fault: self.profile.has_unnamed_fault(state),
            runs: self.runs(state),
        };
        Reported::State(self.transmission.to_joint(&motor), latency, status)
    }

    /// Returns whether the motor reports that it is enabled; `None` where its states have no status.
    /// All bits of a status are zero when a motor is off and has no fault, as in a state of firmware
    /// without a status.
    #[inline(always)]
    fn runs(&mut self, state: &State) -> Option<bool> {
        let runs = self.profile.is_on(state);
        self.has_status |= runs.is_some();
        let is_off = self.has_status && state.status.is_none();
        runs.or(is_off.then_some(false))
    }

    #[inline(always)]
    pub(super) fn classify(&self, payload: &[u8], at: Instant, open: Option<Question>) -> Payload {
        if !payload.is_empty() && !self.profile.is_from(self.id, payload) {
            return Payload::OtherId;
        }
        if self.profile.has_registers && register::is_answer(self.id, payload) {
            return Payload::Register;
        }
        if self.profile.is_fault_report(payload) {
            return Payload::Report;
        }
        if !self.profile.fits_state(payload) {
            return Payload::Unreadable;
        }
        match open == Some(Question::Fault) && self.may_continue(payload, at) {
            true => Payload::Continuation,
            false => Payload::Plain,
        }
    }

    #[inline(always)]
    pub(super) fn accept(
        &mut self,
        payload: &[u8],
        question: Question,
        at: Instant,
        latency: Duration,
    ) -> Reported {
        match question {
            Question::State => match self.profile.decode_state(payload, &self.scales) {
                Ok(state) => self.state(&state, at, latency),
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
        }
    }

    /// Takes an answer to a fault request that may be a late state: the second one with the same
    /// faults counts.
    pub(super) fn accept_ambiguous(&mut self, payload: &[u8], at: Instant) -> Reported {
        let Some(faults) = self.faults_in(payload) else { return Reported::Alive };
        if self.ambiguous.take().is_some_and(|before| before.faults == faults) {
            return Reported::Fault(faults);
        }
        let state = self.profile.decode_state(payload, &self.scales).ok();
        let state = state.map(|state| Last { position: state.position, velocity: state.velocity, at });
        self.ambiguous = Some(Ambiguous { faults, state });
        Reported::Ambiguous(faults)
    }

    /// Forgets an ambiguous answer.
    pub(super) const fn refute(&mut self) {
        self.ambiguous = None;
    }

    /// Forgets an ambiguous answer that `state` continues: it was a state.
    #[cold]
    fn compare_ambiguous(&mut self, state: &State, at: Instant) {
        let before = self.ambiguous.and_then(|ambiguous| ambiguous.state);
        if before.is_some_and(|before| self.follows(before, state, at)) {
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

impl Feedback {
    /// Limits torques to `torque_max`, N·m. Only the two codes next to zero may exceed it.
    fn within(torque_max: f32, scales: &Scales) -> Self {
        let [low, zero, high] = [-torque_max, 0.0, torque_max].map(|torque| exact(torque, scales));
        Self { carried: 0.0, codes: [low.ceil().min(zero.floor()), high.floor().max(zero.ceil())] }
    }

    /// The code for `torque`: one of its two neighbours, such that the error of all codes so far stays within half a
    /// code. What the limit takes away is not carried.
    fn quantise(&mut self, torque: f32, scales: &Scales) -> u16 {
        let exact = exact(torque, scales);
        let [low, high] = self.codes;
        let wanted = exact - self.carried;
        // Codes are not negative: cutting off is rounding down, without a call of the mathematical library.
        let below = f64::from(exact as u16);
        let above = below + f64::from(u8::from(exact > below));
        let code = if wanted - below < 0.5 { below } else { above };
        let code = if code > low { code } else { low };
        let code = if code < high { code } else { high };
        self.carried = (code - wanted).clamp(-0.5, 0.5);
        code as u16
    }
}

/// The torque in codes, before rounding.
fn exact(torque: f32, scales: &Scales) -> f64 {
    scales.torque.quantise(f64::from(torque)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::collection::vec;
    use proptest::prelude::*;

    /// Of the GIM8108-8, by the MIT document 1.1.
    fn scales() -> Scales {
        Scales::by_current(0.125, 8.0).unwrap()
    }

    #[test]
    fn mean_of_thousand_frames_is_within_thousandth_code() {
        let scales = scales();
        let code = 2.0 * f64::from(scales.full_scale()) / 4095.0;
        for thirds in -30..30 {
            let torque = (f64::from(thirds) * 0.3 * code) as f32;
            let exact = exact(torque, &scales);
            let mut feedback = Feedback::within(20.0, &scales);
            let codes: Vec<f64> = (0..1000).map(|_| f64::from(feedback.quantise(torque, &scales))).collect();
            let mean = codes.iter().sum::<f64>() / 1000.0;
            assert!((mean - exact).abs() <= 0.001, "{exact} became {mean}");
        }
    }

    proptest! {
        #[test]
        fn mean_of_many_frames_is_requested_torque(
            before in vec(-19.0_f32..19.0, 0..5),
            torque in -19.0_f32..19.0,
            frames in 1_u16..2000,
        ) {
            let scales = scales();
            let exact = exact(torque, &scales);
            let mut feedback = Feedback::within(20.0, &scales);
            for torque in before {
                feedback.quantise(torque, &scales);
            }
            let mut sum = 0.0;
            for _ in 0..frames {
                let code = f64::from(feedback.quantise(torque, &scales));
                prop_assert!((code - exact).abs() < 1.0, "{} is no neighbour of {}", code, exact);
                sum += code;
            }
            let frames = f64::from(frames);
            prop_assert!((sum / frames - exact).abs() <= 1.0 / frames + 1e-9);
        }

        #[test]
        fn no_code_exceeds_the_allowed_torque(
            limit in 0.06_f32..25.0,
            shares in vec(-1.0_f32..=1.0, 1..50),
        ) {
            let scales = scales();
            let mut feedback = Feedback::within(limit, &scales);
            for share in shares.into_iter().chain([1.0, 1.0, -1.0, -1.0]) {
                let code = feedback.quantise(share * limit, &scales);
                prop_assert!(scales.torque.decode(code).abs() <= f64::from(limit) + 1e-6, "{}", share);
            }
        }
    }

    #[test]
    fn a_position_that_wraps_goes_on() {
        let mut unwrap = Unwrap::new(scales().position);
        let turn = unwrap.period;
        let mut turned = 0.0_f32;
        for _ in 0..1000 {
            turned += 0.11;
            let reported = (turned + turn / 2.0).rem_euclid(turn) - turn / 2.0;
            assert!((unwrap.position(reported) - turned).abs() < 1e-3, "at {turned}");
        }
    }
}
