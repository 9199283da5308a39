//! Checks logs of candump by the marks that the program which disturbed the robot has written.
//!
//! A mark is a line `seconds word...`, with the time in candump's format. A line of the log that is
//! not a frame of a motor, such as candump's report of lost frames, counts as wrong.

pub mod deaths;
pub mod disturbances;
pub mod replies;
pub mod service;
pub mod times;
pub mod trot;

use crate::protocol::codec::Sender;
use crate::protocol::mit::Meaning;
use crate::protocol::ranges::Ranges;
use crate::robot::{Wired, Wiring};
use motord_bus::candump::LogLine;
use motord_bus::{Content, Duration, Frame, FrameId};

/// Most complaints in the output. All are counted.
const COMPLAINTS_MAX: usize = 20;

/// The kind of a command, which does not depend on the motor's [`Ranges`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A start, a zero, a stiffness, a torque or a velocity; or bytes without a meaning.
    Motion,
    /// None of these, only damping.
    Damping,
    /// A stop.
    Stop,
    /// A fault request, a clear, or a request for the value of a register.
    Fault,
}

impl Kind {
    /// Returns one letter: T for motion ("trot"), D, S, and Q for a fault request ("question").
    #[must_use]
    pub const fn letter(self) -> char {
        match self {
            Self::Motion => 'T',
            Self::Damping => 'D',
            Self::Stop => 'S',
            Self::Fault => 'Q',
        }
    }

    fn of(meaning: Option<Meaning>) -> Self {
        match meaning {
            Some(Meaning::Stop) => Self::Stop,
            Some(Meaning::GetFault | Meaning::ClearFault) => Self::Fault,
            Some(meaning) if meaning.is_damping() => Self::Damping,
            _ => Self::Motion,
        }
    }
}

/// A command in a log.
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// Time on the bus, on the clock of the log.
    pub at: Duration,
    /// Index of the motor in the [`Wiring`].
    pub motor: usize,
    /// Its kind.
    pub kind: Kind,
    /// `None` when it does not have eight bytes.
    pub meaning: Option<Meaning>,
    /// Text in candump's format: interface, id and data.
    pub text: String,
}

/// A reply in a log. The rules do not check its content.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reply {
    /// Time on the bus, on the clock of the log.
    pub at: Duration,
    /// Index of the motor in the [`Wiring`].
    pub motor: usize,
}

/// A frame of a log.
#[derive(Debug)]
enum Spoken {
    Command(Command),
    Reply(Reply),
}

impl Spoken {
    const fn at(&self) -> Duration {
        match self {
            Self::Command(command) => command.at,
            Self::Reply(reply) => reply.at,
        }
    }
}

/// An event that happened to the robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mark {
    /// Time of the event, on the clock of the log.
    pub at: Duration,
    /// The word of the mark, and its arguments.
    pub words: Vec<String>,
}

impl Mark {
    /// Returns the word after the time.
    #[must_use]
    pub fn word(&self) -> &str {
        self.words.first().map_or("", String::as_str)
    }
}

/// The result of checking a log.
#[derive(Debug, Default)]
pub struct Verdict {
    /// Figures of the log, for display.
    pub report: Vec<String>,
    /// The first violations, as sentences.
    pub complaints: Vec<String>,
    /// Number of violations.
    pub wrong: usize,
}

impl Verdict {
    /// Records a violation.
    pub fn complain(&mut self, complaint: impl Into<String>) {
        self.wrong += 1;
        if self.wrong <= COMPLAINTS_MAX {
            self.complaints.push(complaint.into());
        }
    }

    /// Records a violation unless this holds.
    fn demand(&mut self, holds: bool, complaint: impl FnOnce() -> String) {
        if !holds {
            self.complain(complaint());
        }
    }
}

/// Rules for a log, whose entries arrive in the order of time.
pub trait Rules {
    /// Begins a mark, and ends the previous one.
    fn mark(&mut self, mark: &Mark, verdict: &mut Verdict);
    /// Checks a command that a motor receives.
    fn command(&mut self, command: &Command, verdict: &mut Verdict);
    /// Checks a motor's reply.
    fn reply(&mut self, _reply: &Reply, _verdict: &mut Verdict) {}
    /// Ends the log.
    fn end(&mut self, verdict: &mut Verdict);
}

/// Passes the log of a robot and the marks to `rules`.
#[must_use]
pub fn check(rules: &mut impl Rules, wiring: &Wiring, marks: &[Mark], log: &str) -> Verdict {
    let mut verdict = Verdict::default();
    let spoken = frames(wiring, log, &mut verdict);
    let mut marks = marks.iter().peekable();
    for frame in &spoken {
        while let Some(mark) = marks.next_if(|mark| mark.at <= frame.at()) {
            rules.mark(mark, &mut verdict);
        }
        match frame {
            Spoken::Command(command) => {
                verdict.demand(is_within(command, wiring.motors[command.motor].position), || {
                    format!("{} is beyond the limits of the joint", command.text)
                });
                rules.command(command, &mut verdict);
            }
            Spoken::Reply(reply) => rules.reply(reply, &mut verdict),
        }
    }
    marks.for_each(|mark| rules.mark(mark, &mut verdict));
    rules.end(&mut verdict);
    verdict
}

/// Returns `true` when a position with stiffness lies within the limits, or beyond them by at most
/// one code.
fn is_within(command: &Command, limits: Option<[f64; 2]>) -> bool {
    let (Some([low, high]), Some(Meaning::Control { position, kp, .. })) = (limits, command.meaning) else {
        return true;
    };
    let code = Ranges::steadywin(1.0).codes().position;
    kp == 0.0 || (low - code..=high + code).contains(&position)
}

/// Parses marks.
///
/// # Errors
///
/// The first line that is not a mark.
pub fn marks(text: &str) -> Result<Vec<Mark>, String> {
    let mark = |line: &str| {
        let mut words = line.split_whitespace();
        let at = words.next().and_then(|time| time.parse().ok());
        let at = at.and_then(|seconds: f64| Duration::try_from_secs_f64(seconds).ok());
        let at = at.ok_or_else(|| format!("not a mark: {line}"))?;
        // The time has microseconds, and a number with a fraction is not exact.
        let at = Duration::from_micros((at.as_nanos() as u64 + 500) / 1000);
        Ok(Mark { at, words: words.map(String::from).collect() })
    };
    text.lines().map(mark).collect()
}

/// Returns the frames of a log with their times. A frame that is a command to no motor must be a
/// reply, or belong to an IMU.
fn frames(wiring: &Wiring, log: &str, verdict: &mut Verdict) -> Vec<Spoken> {
    let mut frames = Vec::new();
    for line in log.lines() {
        match frame(wiring, line) {
            Ok(frame) => frames.extend(frame),
            Err(complaint) => verdict.complain(complaint),
        }
    }
    // Each interface has its frames in order; candump interleaves the interfaces imprecisely.
    frames.sort_by_key(Spoken::at);
    frames
}

/// Returns the frame of a line; `None` for one from or to an IMU, and for a request that equals its
/// answer.
fn frame(wiring: &Wiring, line: &str) -> Result<Option<Spoken>, String> {
    let complaint = || format!("candump says: {line}");
    let LogLine { at, interface, content } = LogLine::parse(line).map_err(|_| complaint())?;
    let Content::Frame(frame) = content else { return Err(complaint()) };
    if !frame.is_classic() {
        return Err(complaint());
    }
    let has_sender = |motor: &Wired, sender| {
        motor.interface == interface && motor.protocol.codec().sender(&frame, &motor.ids) == Some(sender)
    };
    let sent_by = |sender| wiring.motors.iter().position(|motor| has_sender(motor, sender));
    if let Some(motor) = sent_by(Sender::Host) {
        let meaning = wiring.motors[motor].protocol.meaning(&frame);
        if meaning == Some(Meaning::GetFault) && !wiring.motors[motor].answers_question {
            return Err(format!("a question that is a command to this motor: {line}"));
        }
        let text = format!("{interface} {frame:?}");
        return Ok(Some(Spoken::Command(Command { at, motor, kind: Kind::of(meaning), meaning, text })));
    }
    if let Some(motor) = read_of_register(wiring, interface, &frame) {
        let text = format!("{interface} {frame:?}");
        return Ok(Some(Spoken::Command(Command { at, motor, kind: Kind::Fault, meaning: None, text })));
    }
    let is_of_imu = wiring.imus.iter().any(|imu| imu.interface == interface && imu.knows(&frame));
    if is_of_imu || sent_by(Sender::Either).is_some() {
        return Ok(None);
    }
    let motor = sent_by(Sender::Motor).ok_or_else(|| format!("no motor has this id: {line}"))?;
    Ok(Some(Spoken::Reply(Reply { at, motor })))
}

/// Returns the motor whose register this frame reads. A write is no such frame, and has the id of
/// no motor.
fn read_of_register(wiring: &Wiring, interface: &str, frame: &Frame) -> Option<usize> {
    let &[id, 0, 0x33, _, 0, 0, 0, 0] = frame.payload() else { return None };
    let is_read = frame.id() == FrameId::MAX;
    wiring.motors.iter().position(|motor| {
        is_read && motor.has_registers && motor.interface == interface && motor.ids.motor == id
    })
}

/// Formats a time in seconds as candump does.
fn seconds(at: Duration) -> String {
    format!("{}.{:06}", at.as_secs(), at.subsec_micros())
}
