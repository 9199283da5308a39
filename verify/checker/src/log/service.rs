//! The commands that each motor receives after each mark, as a word of letters: T motion, D
//! damping, S stop, Q fault request. A repeated letter is written once. The rules check order, kind
//! and number of the commands, not their times.
//!
//! A safe-stop after the dead man's switch repeats damping and stop. A daemon continues to trot
//! until a request to exit reaches it: a signal takes effect immediately, a request to systemd
//! takes longer.

use super::{Command, Kind, Mark, Rules, Verdict};
use crate::robot::Wiring;

/// The commands that one motor has received since the last mark.
#[derive(Debug, Clone, Default)]
struct MotorCommands {
    word: String,
    motions: usize,
}

/// The rules.
#[derive(Debug)]
pub struct Service<'a> {
    wiring: &'a Wiring,
    mark: String,
    marks: usize,
    motors: Vec<MotorCommands>,
    seen: Vec<bool>,
    frames: usize,
}

impl<'a> Service<'a> {
    /// Returns the rules before the first event.
    #[must_use]
    pub fn new(wiring: &'a Wiring) -> Self {
        let motors = wiring.motors.len();
        Self {
            wiring,
            mark: String::new(),
            marks: 0,
            motors: vec![MotorCommands::default(); motors],
            seen: vec![false; motors],
            frames: 0,
        }
    }

    fn close(&mut self, verdict: &mut Verdict) {
        let (mark, number) = (&self.mark, self.marks);
        let seen = self.wiring.motors.iter().zip(&self.motors).zip(&self.seen).filter(|(_, seen)| **seen);
        for ((motor, MotorCommands { word, motions }), _) in seen {
            let address = motor.address();
            verdict.demand(is_asked(mark, word), || {
                format!("{address} heard \"{word}\" after mark {number} {mark}")
            });
            let few = most(mark).is_none_or(|most| *motions <= most);
            verdict.demand(few, || {
                format!("{address} received {motions} commands to move after mark {number} {mark}")
            });
        }
        self.motors.fill(MotorCommands::default());
    }
}

/// Returns `true` when `mark` expects `word`. Other marks and the time before the first mark permit
/// every word.
fn is_asked(mark: &str, word: &str) -> bool {
    let end = word.strip_prefix('T').unwrap_or(word);
    match mark {
        "rest" => word.is_empty() || word == "S",
        "trot" => word == "T",
        "died" => !end.is_empty() && end.replace("DS", "").is_empty(),
        "stopped" => end == "DS",
        "silent" => word.is_empty(),
        _ => true,
    }
}

/// Returns the most commands to move: half a second after a death, three seconds after a request
/// (20 cycles a second).
fn most(mark: &str) -> Option<usize> {
    match mark {
        "died" => Some(10),
        "stopped" => Some(60),
        _ => None,
    }
}

impl Rules for Service<'_> {
    fn mark(&mut self, mark: &Mark, verdict: &mut Verdict) {
        self.close(verdict);
        self.mark = mark.word().into();
        self.marks += 1;
    }

    fn command(&mut self, command: &Command, _: &mut Verdict) {
        self.seen[command.motor] = true;
        self.frames += 1;
        if command.kind == Kind::Fault && self.mark != "silent" {
            return;
        }
        let received = &mut self.motors[command.motor];
        received.motions += usize::from(command.kind == Kind::Motion);
        if !received.word.ends_with(command.kind.letter()) {
            received.word.push(command.kind.letter());
        }
    }

    fn end(&mut self, verdict: &mut Verdict) {
        self.close(verdict);
        let motors = self.seen.iter().filter(|seen| **seen).count();
        let (frames, marks, all) = (self.frames, self.marks, self.seen.len());
        verdict.report.push(format!("{frames} frames to {motors} motors, {marks} marks"));
        verdict.demand(motors == all && marks > 0, || format!("{motors} motors of {all}, {marks} marks"));
    }
}
