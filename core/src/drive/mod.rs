//! One drive: converts commands to frames, and frames to replies.
//!
//! A [`Dialect`] encodes the commands of one family and reads its frames. The `correlator` decides
//! which request a frame answers. Only a reply that it accepts changes what the dialect remembers.
//!
//! Real-time: after [`Drive::new`] nothing here allocates, blocks, loops or calls the system.

mod correlator;

pub(crate) use correlator::LATEST_REPLY;
use correlator::{Correlator, Role};
use motord_bus::{Duration, Frame, Instant};
use motord_protocol::AnyDialect;
use motord_protocol::drive::{
    Arrived, Command, Dialect, Impedance, JointSide, Measured, Question, Reported, Setpoint, Status,
};
use motord_settings::settings::MotorSettings;

/// The meaning of a received frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Received {
    /// A reply and its content.
    Reply(Reported),
    /// Answers no request.
    Duplicate,
    /// It has the id of another motor.
    UnexpectedId,
    /// It does not decode, or cannot be an answer to the open request.
    Malformed,
}

/// Returns the two frames that damp a motor without a cycle, and the one that stops it. A motor
/// must receive the first two in turn: neither velocity nor torque has a code for zero, and each of
/// the frames pushes the joint as much as the other pushes it back. A motor without an impedance
/// mode is stopped without damping: the commands that brake it may be full torque to a motor in
/// another mode, and its mode is not known.
#[must_use]
pub fn safe_frames(motor: &MotorSettings) -> Option<([Frame; 2], Frame)> {
    let mut drive = Drive::new(motor, Duration::ZERO, true);
    let mut make = |command| drive.request(&command, Instant::ZERO);
    let damping = Impedance::new(0.0, 0.0, 0.0, motor.damping_kd, 0.0);
    let damping = Command::Control(Setpoint::impedance(damping));
    // A stop may withdraw the permission for impedances, so it is the last.
    let damp = if motor.capabilities.impedance { Some([make(damping)?, make(damping)?]) } else { None };
    let stop = make(Command::Stop)?;
    Some((damp.unwrap_or([stop; 2]), stop))
}

/// One drive.
#[derive(Debug)]
pub struct Drive {
    dialect: AnyDialect,
    correlator: Correlator,
}

impl Drive {
    /// `fastest_reply` is the time that command and reply need at least on this bus; zero where it
    /// is not known. Does not allocate.
    #[must_use]
    pub fn new(settings: &MotorSettings, fastest_reply: Duration, error_feedback: bool) -> Self {
        let dialect = AnyDialect::new(settings.protocol, &settings.drive(error_feedback));
        Self { dialect, correlator: Correlator::new(fastest_reply) }
    }

    /// The frame for `command`, to be sent at `now`; `None` for [`Command::Nothing`] and
    /// [`Command::Wait`]. Opens a request. Constant time.
    pub fn request(&mut self, command: &Command, now: Instant) -> Option<Frame> {
        let mut frame = Frame::EMPTY;
        self.write_request(command, now, &mut frame).then_some(frame)
    }

    /// As [`request`](Self::request), but writes into `frame`. Returns whether there is a frame. No
    /// request is open after one that the motor does not answer.
    #[inline(always)]
    pub fn write_request(&mut self, command: &Command, now: Instant, frame: &mut Frame) -> bool {
        let question = self.dialect.encode(command, frame);
        match question {
            Some(Question::Unanswered) => self.correlator.send(now),
            Some(question) => self.correlator.request(question, now),
            None => {}
        }
        question.is_some()
    }

    /// Uses these ends of the codes from now on: position, rad, velocity, rad/s, and torque, N·m.
    /// Only for a stopped motor. Constant time.
    pub fn use_ends(&mut self, ends: [f32; 3]) {
        self.dialect.use_ends(ends);
    }

    /// Withdraws the open request, whose frame was not sent.
    pub fn withdraw(&mut self) {
        self.correlator = self.correlator.withdraw();
        self.dialect.unsent();
    }

    /// Closes the open request, which the motor could not read. Constant time.
    pub fn refuse(&mut self) -> Received {
        if !self.is_open() {
            return Received::Malformed;
        }
        self.correlator = self.correlator.withdraw();
        Received::Reply(Reported::Refused)
    }

    /// Returns whether a request is open.
    #[must_use]
    #[inline]
    pub const fn is_open(&self) -> bool {
        self.correlator.is_open()
    }

    /// Takes `frame`, which arrived at `at` with an id of this motor, if it is a state that answers
    /// the open request. Returns the state, the time since the request, and the status. `None`,
    /// without a change, for any other frame, and for a few such states:
    /// [`receive`](Self::receive) takes them. Nearly all frames are such states. Constant time.
    #[inline(always)]
    pub fn receive_state(
        &mut self,
        frame: &Frame,
        at: Instant,
    ) -> Option<(Measured<JointSide>, Duration, Status)> {
        let latency = self.correlator.state_latency(at)?;
        let (state, status) = self.dialect.accept_state(Arrived::new(frame, at))?;
        self.correlator = self.correlator.withdraw();
        Some((state, latency, status))
    }

    /// Classifies `frame`, which arrived at `at` with an id of this motor. Constant time.
    pub fn receive(&mut self, frame: &Frame, at: Instant) -> Received {
        let Self { dialect, correlator } = self;
        let arrived = Arrived::new(frame, at);
        let shape = dialect.classify(arrived, correlator.question(at));
        let (question, latency) = match correlator.receive(shape, at) {
            Role::Answer(question, latency) => (question, latency),
            Role::LateReport => (Question::Fault, Duration::ZERO),
            Role::LateRegister => return Received::Reply(dialect.accept_late_register(arrived)),
            Role::Ambiguous => return Received::Reply(dialect.accept_ambiguous(arrived)),
            Role::Late => {
                dialect.refute();
                return Received::Reply(Reported::Late);
            }
            Role::Duplicate => {
                dialect.refute();
                return Received::Duplicate;
            }
            Role::Unprompted => return Received::Reply(dialect.accept_unprompted(arrived)),
            Role::UnexpectedId => return Received::UnexpectedId,
            Role::Malformed => return Received::Malformed,
        };
        Received::Reply(dialect.accept(arrived, question, latency))
    }
}
