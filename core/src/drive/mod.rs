//! One drive: converts commands to frames, and payloads to replies.
//!
//! A dialect (`mit`, `gim`) encodes the commands of one protocol and reads its payloads. The `correlator` decides which
//! request a payload answers. Only a reply that it accepts changes what the dialect remembers.
//!
//! Real-time: after [`Drive::new`] nothing here allocates, blocks, loops or calls the system.

mod correlator;
mod gim;
mod imu;
mod mit;

use crate::control::{Command, Reported};
pub(crate) use correlator::LATEST_REPLY;
use correlator::{Correlator, Payload, Question, Role};
pub(crate) use imu::ImuDrive;
use motord_bus::{Duration, Frame, FrameId, Instant, serial};
use motord_protocol::MotorProtocol;
use motord_settings::joint::{Impedance, Setpoint};
use motord_settings::settings::{BusKind, MotorSettings, Settings};

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

/// Returns whether the payload `reply` can answer the payload `request` on a serial line, judged by
/// their bytes alone. Real-time: does not allocate or block; takes constant time.
#[must_use]
pub fn repeats(request: &[u8], reply: &[u8]) -> bool {
    motord_protocol::gim::repeats(request, reply)
}

/// Returns the serial line with this index, and its motors. A request without an answer is given up after `reply_timeout`. Allocates.
#[must_use]
pub fn line(settings: &Settings, index: usize, reply_timeout: Duration) -> serial::Settings {
    let address = |motor: &MotorSettings| serial::Address {
        id: motor.id,
        host_id: u8::try_from(motor.host_id.raw()).ok(),
    };
    let device = match &settings.buses[index].kind {
        BusKind::Serial { device, .. } => device.clone(),
        BusKind::SocketCan { .. } | BusKind::Simulated { .. } => String::new(),
    };
    serial::Settings {
        device,
        baud: settings.buses[index].kind.bitrate(),
        addresses: settings.motors.iter().filter(|motor| motor.bus == index).map(address).collect(),
        reply_timeout,
        answers: repeats,
    }
}

/// Returns the two frames that damp a motor without a cycle, and the one that stops it. An MIT motor
/// must receive the first two in turn: neither velocity nor torque has a code for zero, and each of
/// the frames pushes the joint as much as the other pushes it back. A GIM motor is stopped without
/// damping: the speed commands that brake it may be full torque to a motor in MIT mode, and its
/// mode is not known.
#[must_use]
pub fn safe_frames(motor: &MotorSettings) -> Option<([Frame; 2], Frame)> {
    let mut drive = Drive::new(motor, Duration::ZERO, true);
    let mut make = |command| drive.request(&command, Instant::ZERO);
    let stop = make(Command::Stop)?;
    let damping = Impedance::new(0.0, 0.0, 0.0, motor.damping_kd, 0.0);
    let damping = Command::Control(Setpoint::impedance(damping));
    let damp = match motor.protocol {
        MotorProtocol::Mit => [make(damping)?, make(damping)?],
        MotorProtocol::Gim => [stop; 2],
    };
    Some((damp, stop))
}

/// One drive.
#[derive(Debug)]
pub struct Drive {
    command_id: FrameId,
    dialect: Dialect,
    correlator: Correlator,
}

#[derive(Debug)]
enum Dialect {
    Mit(mit::Mit),
    Gim(gim::Gim),
}

impl Drive {
    /// `fastest_reply` is the time that command and reply need at least on this bus; zero where it is not known. Does not
    /// allocate.
    #[must_use]
    pub fn new(settings: &MotorSettings, fastest_reply: Duration, error_feedback: bool) -> Self {
        let dialect = match settings.protocol {
            MotorProtocol::Mit => Dialect::Mit(mit::Mit::new(settings, error_feedback)),
            MotorProtocol::Gim => Dialect::Gim(gim::Gim::new(settings)),
        };
        Self { command_id: settings.command_id(), dialect, correlator: Correlator::new(fastest_reply) }
    }

    /// The frame for `command`, to be sent at `now`; `None` for [`Command::Nothing`] and [`Command::Wait`]. Opens a request. Constant time.
    pub fn request(&mut self, command: &Command, now: Instant) -> Option<Frame> {
        let mut frame = Frame::EMPTY;
        self.write_request(command, now, &mut frame).then_some(frame)
    }

    /// As [`request`](Self::request), but writes into `frame`. Returns whether there is a frame.
    #[inline(always)]
    pub fn write_request(&mut self, command: &Command, now: Instant, frame: &mut Frame) -> bool {
        let is_written = match &mut self.dialect {
            Dialect::Mit(mit) => mit.encode(command, self.command_id, frame),
            Dialect::Gim(gim) => gim.encode(command, self.command_id, frame),
        };
        if is_written.is_some() {
            let question = self.question(command);
            self.correlator.request(question, now);
        }
        is_written.is_some()
    }

    /// Returns the content that the motor reports in answer to a command.
    const fn question(&self, command: &Command) -> Question {
        match (command, &self.dialect) {
            (Command::GetFault, Dialect::Mit(mit)) if !mit.answers_fault_question() => Question::State,
            (Command::GetFault, _) => Question::Fault,
            (Command::GetRegister(_), Dialect::Mit(_)) => Question::Register,
            (Command::ClearFault, _) => Question::Clear,
            _ => Question::State,
        }
    }

    /// Uses these ends of the codes from now on: position, rad, velocity, rad/s, and torque, N·m. Only for a stopped motor.
    /// Constant time.
    pub fn use_ends(&mut self, ends: [f32; 3]) {
        if let Dialect::Mit(mit) = &mut self.dialect {
            mit.use_ends(ends);
        }
    }

    /// Withdraws the open request, whose frame was not sent.
    pub const fn withdraw(&mut self) {
        self.correlator = self.correlator.withdraw();
    }

    /// Closes the open request, which the motor could not read. Constant time.
    pub fn refuse(&mut self) -> Received {
        if !self.is_open() {
            return Received::Malformed;
        }
        self.withdraw();
        Received::Reply(Reported::Refused)
    }

    /// Returns whether a request is open.
    #[must_use]
    #[inline]
    pub const fn is_open(&self) -> bool {
        self.correlator.is_open()
    }

    /// Judges `payload`, which arrived at `at` under this drive's reply id. Constant time.
    #[inline(always)]
    pub fn receive(&mut self, payload: &[u8], at: Instant) -> Received {
        let Self { dialect, correlator, .. } = self;
        let kind = dialect.classify(payload, at, correlator.question());
        let (question, latency) = match correlator.receive(kind, at) {
            Role::Answer(question, latency) => (question, latency),
            Role::LateReport => (Question::Fault, Duration::ZERO),
            Role::LateRegister => return Received::Reply(dialect.accept_late_register(payload)),
            Role::Ambiguous => return Received::Reply(dialect.accept_ambiguous(payload, at)),
            Role::Late => {
                dialect.refute();
                return Received::Reply(Reported::Late);
            }
            Role::Duplicate => {
                dialect.refute();
                return Received::Duplicate;
            }
            Role::UnexpectedId => return Received::UnexpectedId,
            Role::Malformed => return Received::Malformed,
        };
        Received::Reply(dialect.accept(payload, question, at, latency))
    }
}

impl Dialect {
    /// Returns the kind of a payload that arrived at `at` with this motor's reply id, while `open`
    /// is open. Pure: the payload may be late. Distinguishes a continuation of the motion from a
    /// plain reply only while a fault request is open.
    #[inline(always)]
    fn classify(&self, payload: &[u8], at: Instant, open: Option<Question>) -> Payload {
        match self {
            Self::Mit(mit) => mit.classify(payload, at, open),
            Self::Gim(gim) => gim.classify(payload),
        }
    }

    /// Takes a payload that may be a fault report. Only MIT has such replies.
    #[cold]
    fn accept_ambiguous(&mut self, payload: &[u8], at: Instant) -> Reported {
        match self {
            Self::Mit(mit) => mit.accept_ambiguous(payload, at),
            Self::Gim(_) => Reported::Alive,
        }
    }

    /// Takes a register that answers an earlier question. Only MIT has such replies.
    #[cold]
    fn accept_late_register(&mut self, payload: &[u8]) -> Reported {
        self.refute();
        match self {
            Self::Mit(mit) => mit.accept_late_register(payload),
            Self::Gim(_) => Reported::Late,
        }
    }

    /// Forgets an ambiguous report: replies are late, so it was probably one of them.
    #[cold]
    const fn refute(&mut self) {
        if let Self::Mit(mit) = self {
            mit.refute();
        }
    }

    /// Takes a payload of a known kind as the answer to `question`, `latency` after that was sent.
    #[inline(always)]
    fn accept(&mut self, payload: &[u8], question: Question, at: Instant, latency: Duration) -> Reported {
        match self {
            Self::Mit(mit) => mit.accept(payload, question, at, latency),
            Self::Gim(gim) => gim.accept(payload, at, latency),
        }
    }
}
