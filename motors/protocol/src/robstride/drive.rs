//! A drive in RobStride's private protocol.
//!
//! Real-time: after [`RobStrideDialect::new`] nothing here allocates, blocks or loops.

use super::frame::{self, Feedback, Id, Reply, faults_of_report};
use super::{ControlCodes, WideScales, parameter};
use crate::Faults;
use crate::drive::{
    Arrived, Command, Dialect, DriveSettings, Impedance, JointSide, Measured, MotorSide, Question, Reported,
    Shape, Status, Supply, Transmission, Unwrap,
};
use motord_bus::{Duration, Frame, FrameId, Instant};

/// A motor that reports its state unasked with the type of an answer does so at most every 10 ms
/// (parameter 0x7026). Of two such frames that follow faster, the second is the answer of another
/// motor with the same id.
const REPORT_PERIOD_MIN: Duration = Duration::from_millis(8);

/// A motor that is disabled in this many states in a row after it was to be enabled has a fault: no
/// bit of a state has an over-voltage, and its report is sent once and may be lost.
const REFUSALS_MAX: u8 = 100;

/// The dialect of one motor in RobStride's private protocol.
///
/// Zero lies half a code off, as in every protocol with such codes. A code of torque is at most
/// 3.7 mN·m, so no error is carried from frame to frame.
#[derive(Debug)]
pub struct RobStrideDialect {
    motor: u8,
    host: u8,
    scales: WideScales,
    transmission: Transmission,
    unwrap: Option<Unwrap>,
    /// The faults of the last fault report, which a state may not have. The motor clears them on
    /// request.
    reported: Faults,
    /// When the last state arrived that no request explains.
    unprompted_at: Instant,
    /// The number of states since the command to enable that report a disabled motor; `None` where
    /// it was stopped.
    refusals: Option<u8>,
    /// The last question for the supply is not answered yet.
    awaits_supply: bool,
}

impl RobStrideDialect {
    /// Does not allocate.
    #[must_use]
    pub fn new(settings: &DriveSettings) -> Self {
        let scales = WideScales::of(&settings.scales);
        Self {
            motor: settings.id,
            host: settings.host_id.raw() as u8,
            unwrap: settings.wraps.then(|| Unwrap::new(scales.position)),
            scales,
            transmission: settings.transmission,
            reported: Faults::NONE,
            unprompted_at: Instant::ZERO,
            refusals: None,
            awaits_supply: false,
        }
    }

    /// Forgets the turns, and the faults of a report: the motor is silent, and may return after a
    /// loss of power.
    #[cold]
    fn forget(&mut self) {
        self.refusals = None;
        self.forget_turns();
        self.reported = Faults::NONE;
    }

    fn forget_turns(&mut self) {
        if let Some(unwrap) = &mut self.unwrap {
            *unwrap = Unwrap::new(self.scales.position);
        }
    }

    /// Returns the control command for an impedance. `None` where a value is not finite.
    #[inline]
    fn control(&self, wanted: &Impedance<MotorSide>) -> Option<frame::Command> {
        let Impedance { position, velocity, kp, kd, torque, .. } = *wanted;
        ControlCodes::nearest([position, velocity, kp, kd, torque], &self.scales).map(frame::Command::Control)
    }

    /// Returns the content of a frame from this motor.
    #[inline]
    fn decode(&self, arrived: Arrived<'_>) -> Option<Reply> {
        let is_formed = arrived.id.is_extended() && arrived.format == motord_bus::Format::Classic;
        let (motor, reply) =
            Reply::decode(Id::of(arrived.id.raw()), arrived.payload).filter(|_| is_formed)?;
        (motor == self.motor).then_some(reply)
    }

    /// Returns the state, joint side, and the status.
    #[inline]
    fn state(&mut self, feedback: &Feedback) -> (Measured<JointSide>, Status) {
        let [position, velocity, torque] = feedback.scaled(&self.scales);
        let position = self.unwrap.as_mut().map_or(position, |unwrap| unwrap.position(position));
        let motor = Measured::<MotorSide>::new(position, velocity, torque, Some(feedback.celsius()));
        let refusal = if self.refuses(feedback.is_on()) { Faults::START_FAILURE } else { Faults::NONE };
        let status = Status {
            faults: Some(feedback.faults().and(self.reported).and(refusal)),
            has_unnamed_fault: false,
            runs: Some(feedback.is_on()),
        };
        (self.transmission.to_joint(&motor), status)
    }

    /// Records a state. Returns whether the motor stays disabled although it was to be enabled.
    #[inline]
    fn refuses(&mut self, is_on: bool) -> bool {
        let Some(refusals) = &mut self.refusals else { return false };
        *refusals = if is_on { 0 } else { refusals.saturating_add(1) };
        *refusals >= REFUSALS_MAX
    }

    fn take_supply(&mut self, reply: &Reply) -> Reported {
        self.awaits_supply = false;
        supply(reply).map_or(Reported::Late, Reported::Supply)
    }

    /// Returns whether a state without an open request, at this time, may be an unasked report.
    fn may_be_report(&self, at: Instant) -> bool {
        at.since(self.unprompted_at) >= REPORT_PERIOD_MIN
    }
}

impl Dialect for RobStrideDialect {
    #[inline]
    fn encode(&mut self, command: &Command, frame: &mut Frame) -> Option<Question> {
        let question = match command {
            Command::ClearFault => Question::Clear,
            Command::GetSupply => Question::Register,
            _ => Question::State,
        };
        let command = match command {
            Command::Control(setpoint) => self.control(&self.transmission.to_motor(&setpoint.values))?,
            Command::Neutral => self.control(&Impedance::NEUTRAL)?,
            Command::Nothing => {
                self.forget();
                return None;
            }
            Command::Wait | Command::GetIndicator(_) | Command::GetRegister(_) => return None,
            Command::GetSupply => frame::Command::Read(parameter::SUPPLY_VOLTAGE),
            // Every state has the faults.
            Command::Stop | Command::GetFault => {
                self.refusals = None;
                frame::Command::Stop
            }
            Command::Start => {
                self.refusals.get_or_insert(0);
                frame::Command::Enable
            }
            Command::SetZero => {
                self.forget_turns();
                frame::Command::SetZero
            }
            Command::ClearFault => {
                self.refusals = None;
                frame::Command::ClearFault
            }
        };
        self.awaits_supply |= question == Question::Register;
        let (id, payload) = command.encode(self.motor, self.host);
        frame.set(FrameId::extended(id.raw())?, payload);
        Some(question)
    }

    #[inline]
    fn classify(&self, arrived: Arrived<'_>, open: Option<Question>) -> Shape {
        match self.decode(arrived) {
            Some(Reply::Feedback(_)) if open.is_none() && self.may_be_report(arrived.at) => Shape::Unprompted,
            Some(Reply::Feedback(_)) => Shape::Plain,
            Some(ref reply) if self.awaits_supply && supply(reply).is_some() => Shape::Register,
            // Unprompted reports, and answers to another program.
            Some(_) => Shape::Unprompted,
            None => Shape::Unreadable,
        }
    }

    #[inline]
    fn accept_state(&mut self, arrived: Arrived<'_>) -> Option<(Measured<JointSide>, Status)> {
        match self.decode(arrived)? {
            Reply::Feedback(feedback) => Some(self.state(&feedback)),
            _ => None,
        }
    }

    fn accept(&mut self, arrived: Arrived<'_>, question: Question, latency: Duration) -> Reported {
        match (self.decode(arrived), question) {
            (Some(Reply::Feedback(feedback)), Question::State) => {
                let (measured, status) = self.state(&feedback);
                Reported::State(measured, latency, status)
            }
            (Some(Reply::Feedback(_)), Question::Clear) => {
                self.reported = Faults::NONE;
                Reported::Cleared
            }
            (Some(ref reply), Question::Register) => self.take_supply(reply),
            _ => Reported::Alive,
        }
    }

    #[cold]
    fn accept_late_register(&mut self, arrived: Arrived<'_>) -> Reported {
        self.decode(arrived).map_or(Reported::Late, |reply| self.take_supply(&reply))
    }

    #[cold]
    fn accept_unprompted(&mut self, arrived: Arrived<'_>) -> Reported {
        match self.decode(arrived) {
            Some(Reply::Faults { faults, .. }) => {
                self.reported = faults_of_report(faults);
                if self.reported.is_none() { Reported::Unprompted } else { Reported::Fault(self.reported) }
            }
            Some(Reply::Feedback(_)) => {
                self.unprompted_at = arrived.at;
                Reported::Unprompted
            }
            _ => Reported::Unprompted,
        }
    }
}

/// Returns the supply that a reply reports.
fn supply(reply: &Reply) -> Option<Supply> {
    match *reply {
        Reply::Parameter(parameter::SUPPLY_VOLTAGE, Some(value)) => {
            Some(Supply { voltage: f32::from_le_bytes(value), current: None })
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::execution_time::ExecutionTime;
    use crate::profile::Profile;
    use crate::robstride::HOST_ID;

    /// A state in mode 2 in the middle of the codes, 25.0 °C.
    const REST: [u8; 8] = [0x80, 0x00, 0x80, 0x00, 0x80, 0x00, 0x00, 0xFA];

    /// An RS02 with id 5.
    fn dialect() -> RobStrideDialect {
        let (profile, model) = Profile::of_model("RS02").unwrap();
        RobStrideDialect::new(&DriveSettings {
            id: 5,
            host_id: FrameId::from(HOST_ID),
            profile,
            scales: model.scales().unwrap(),
            gear_ratio: 8.0,
            transmission: Transmission::new(1.0, 0.0),
            limits: [10.0, 10.0],
            wraps: false,
            duration: ExecutionTime::MAX,
            error_feedback: true,
        })
    }

    fn frame(raw: u32, payload: [u8; 8]) -> Frame {
        Frame::classic(FrameId::extended(raw).unwrap(), payload)
    }

    const fn millis(millis: u64) -> Instant {
        Instant::from_nanos(millis * 1_000_000)
    }

    #[test]
    fn only_rare_states_without_request_are_reports() {
        let mut dialect = dialect();
        let state = frame(0x0280_05FD, REST);
        let mut shape = |at| {
            let arrived = Arrived::new(&state, millis(at));
            let shape = dialect.classify(arrived, None);
            if shape == Shape::Unprompted {
                dialect.accept_unprompted(arrived);
            }
            shape
        };
        let shapes = [100, 101, 107, 110, 120].map(&mut shape);
        use Shape::{Plain, Unprompted};
        assert_eq!(shapes, [Unprompted, Plain, Plain, Unprompted, Unprompted]);
        let open = dialect.classify(Arrived::new(&state, millis(200)), Some(Question::State));
        assert_eq!(open, Plain);
    }

    #[test]
    fn other_frames_of_motor_answer_no_request() {
        let dialect = dialect();
        for (raw, payload, shape) in [
            (0x1880_05FD, REST, Shape::Unprompted),
            (0x0280_05FD, [0x00, 0xC4, 0x56, 3, 5, 3, 7, 0], Shape::Unprompted),
            (0x1100_05FD, [0x28, 0x70, 0, 0, 0, 0, 0, 0], Shape::Unprompted),
            (0x0280_06FD, REST, Shape::Unreadable),
            (0x0380_05FD, REST, Shape::Unreadable),
        ] {
            let frame = frame(raw, payload);
            for open in [None, Some(Question::State), Some(Question::Clear)] {
                assert_eq!(dialect.classify(Arrived::new(&frame, millis(1)), open), shape, "{frame:?}");
            }
        }
        let standard = Frame::classic(FrameId::new(0x5FD).unwrap(), REST);
        assert_eq!(dialect.classify(Arrived::new(&standard, millis(1)), None), Shape::Unreadable);
    }

    /// Seed 299 of the fault injection: the report of an over-voltage was lost, and its group waited
    /// for the motor without an end.
    #[test]
    fn refused_enable_is_a_fault() {
        let mut dialect = dialect();
        let off = frame(0x0200_05FD, REST);
        let after = |dialect: &mut RobStrideDialect, command, states: u8| {
            dialect.encode(&command, &mut { Frame::EMPTY });
            let mut state = || dialect.accept_state(Arrived::new(&off, millis(1))).unwrap().1.faults;
            (0..states).filter(|_| state() == Some(Faults::START_FAILURE)).count()
        };
        assert_eq!(after(&mut dialect, Command::Start, REFUSALS_MAX), 1);
        assert_eq!(after(&mut dialect, Command::Neutral, 5), 5);
        assert_eq!(after(&mut dialect, Command::Stop, REFUSALS_MAX), 0);
        assert_eq!(after(&mut dialect, Command::Start, REFUSALS_MAX - 1), 0);
    }

    #[test]
    fn reported_fault_stays_until_cleared_or_silent() {
        let (state, report) = (frame(0x0280_05FD, REST), frame(0x1500_05FD, [0x08, 0, 0, 0, 0, 0, 0, 0]));
        let faults = |dialect: &mut RobStrideDialect| {
            dialect.accept_state(Arrived::new(&state, millis(1))).unwrap().1.faults
        };
        for end in [Command::ClearFault, Command::Nothing] {
            let mut dialect = dialect();
            let reported = dialect.accept_unprompted(Arrived::new(&report, millis(1)));
            assert_eq!(reported, Reported::Fault(Faults::OVER_VOLTAGE));
            assert_eq!(faults(&mut dialect), Some(Faults::OVER_VOLTAGE));
            if let Some(question) = dialect.encode(&end, &mut { Frame::EMPTY }) {
                dialect.accept(Arrived::new(&state, millis(2)), question, Duration::ZERO);
            }
            assert_eq!(faults(&mut dialect), Some(Faults::NONE), "{end:?}");
        }
    }

    #[test]
    fn value_that_is_not_finite_is_not_sent() {
        use crate::drive::Setpoint;
        let wanted = Setpoint::impedance(Impedance::<JointSide>::new(0.0, 0.0, 1.0, f32::NAN, 0.0));
        assert_eq!(dialect().encode(&Command::Control(wanted), &mut { Frame::EMPTY }), None);
    }
}
