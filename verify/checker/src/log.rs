//! Logs of candump, judged by the marks that whoever disturbed the robot has written beside them.
//!
//! A mark is a line `seconds word...`, with the time as candump tells it. A line of the log that is not a frame of a motor,
//! such as candump's report of frames it lost, counts as wrong.

pub mod deaths;
pub mod disturbances;
pub mod replies;
pub mod service;
pub mod times;
pub mod trot;

use crate::codec::{Meaning, Ranges};
use crate::robot::Wiring;
use motord_bus::candump::LogLine;
use motord_bus::{Content, Duration};

/// No more complaints than this are told; all are counted.
const COMPLAINTS_MAX: usize = 20;

/// The kind of a command, which does not depend on the motor's [`Ranges`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A start, a zero, a stiffness, a torque or a velocity; or bytes that mean nothing.
    Motion,
    /// None of these, but damping.
    Damping,
    /// A stop.
    Stop,
    /// A question for a fault, or its clearing.
    Fault,
}

impl Kind {
    /// One letter: T as in told to move, D, S, and Q as in question.
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
    /// When it was on the bus, as the log counts.
    pub at: Duration,
    /// Index of the motor in the [`Wiring`].
    pub motor: usize,
    /// Its kind.
    pub kind: Kind,
    /// `None` when it has not eight bytes.
    pub meaning: Option<Meaning>,
    /// As candump spells it: interface, id and data.
    pub text: String,
}

/// A reply in a log. Its content is not judged here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reply {
    /// When it was on the bus, as the log counts.
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

/// Something that happened to the robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mark {
    /// When, as the log counts.
    pub at: Duration,
    /// The word of the mark, and its arguments.
    pub words: Vec<String>,
}

impl Mark {
    /// The word after the time.
    #[must_use]
    pub fn word(&self) -> &str {
        self.words.first().map_or("", String::as_str)
    }
}

/// The result of judging a log.
#[derive(Debug, Default)]
pub struct Verdict {
    /// Figures of the log, for a reader.
    pub report: Vec<String>,
    /// The first broken rules, in words.
    pub complaints: Vec<String>,
    /// The number of broken rules.
    pub wrong: usize,
}

impl Verdict {
    /// Something is wrong.
    pub fn complain(&mut self, complaint: impl Into<String>) {
        self.wrong += 1;
        if self.wrong <= COMPLAINTS_MAX {
            self.complaints.push(complaint.into());
        }
    }

    /// Complains unless this holds.
    fn demand(&mut self, holds: bool, complaint: impl FnOnce() -> String) {
        if !holds {
            self.complain(complaint());
        }
    }
}

/// Rules for a log, which is shown in the order of time.
pub trait Rules {
    /// A mark begins, and the one before ends.
    fn mark(&mut self, mark: &Mark, verdict: &mut Verdict);
    /// A motor hears a command.
    fn command(&mut self, command: &Command, verdict: &mut Verdict);
    /// A motor replies.
    fn reply(&mut self, _reply: &Reply, _verdict: &mut Verdict) {}
    /// The log is over.
    fn end(&mut self, verdict: &mut Verdict);
}

/// Shows `rules` the log of a robot and the marks.
#[must_use]
pub fn judge(rules: &mut impl Rules, wiring: &Wiring, marks: &[Mark], log: &str) -> Verdict {
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

/// Whether a position that is followed lies within the limits, or beyond them by one code at most.
fn is_within(command: &Command, limits: Option<[f64; 2]>) -> bool {
    let (Some([low, high]), Some(Meaning::Control { position, kp, .. })) = (limits, command.meaning) else {
        return true;
    };
    let code = Ranges::steadywin(1.0).codes().position;
    kp == 0.0 || (low - code..=high + code).contains(&position)
}

/// Reads marks.
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

/// The frames of a log by their times. A frame that goes to no motor must be the reply of one.
fn frames(wiring: &Wiring, log: &str, verdict: &mut Verdict) -> Vec<Spoken> {
    let mut frames = Vec::new();
    for line in log.lines() {
        match frame(wiring, line) {
            Ok(frame) => frames.push(frame),
            Err(complaint) => verdict.complain(complaint),
        }
    }
    // Each interface tells its frames in order; candump mixes them a little.
    frames.sort_by_key(Spoken::at);
    frames
}

fn frame(wiring: &Wiring, line: &str) -> Result<Spoken, String> {
    let said = || format!("candump says: {line}");
    let LogLine { at, interface, content } = LogLine::parse(line).map_err(|_| said())?;
    let Content::Frame(frame) = content else { return Err(said()) };
    if !frame.is_classic() {
        return Err(said());
    }
    let id = frame.id();
    let is_to = |motor: &crate::robot::Wired| motor.interface == interface && motor.id == id;
    if let Some(motor) = wiring.motors.iter().position(is_to) {
        // A kind depends on no range, so one serves for every motor.
        let bytes = frame.payload().try_into().ok();
        let meaning = bytes.map(|bytes| Meaning::of(bytes, &Ranges::steadywin(1.0)));
        if meaning == Some(Meaning::GetFault) && !wiring.motors[motor].answers_question {
            return Err(format!("a question that is a command to this motor: {line}"));
        }
        let text = format!("{interface} {frame:?}");
        return Ok(Spoken::Command(Command { at, motor, kind: Kind::of(meaning), meaning, text }));
    }
    let replies = |motor: &crate::robot::Wired| motor.interface == interface && motor.reply_id == id;
    let motor = wiring.motors.iter().position(replies);
    let motor = motor.ok_or_else(|| format!("no motor has this id: {line}"))?;
    Ok(Spoken::Reply(Reply { at, motor }))
}

/// A time in seconds, as candump tells it.
fn seconds(at: Duration) -> String {
    format!("{}.{:06}", at.as_secs(), at.subsec_micros())
}
