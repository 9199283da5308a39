//! One drive on the wire: commands become frames, frames become answers, and an answer is read as what was asked.
//!
//! A reply in MIT does not say what it answers, and a late one looks like a timely one, so a drive keeps at most one
//! request open and judges by time: what arrives before its question was sent, or sooner than the wire could carry
//! both, answers an earlier one. After a question for the fault that was not answered in its cycle, the next answer is
//! dropped whatever it is: its bytes could be fault bits that look like a position (protocol note M2). Unless it has the
//! shape of a fault report, which no state has: then it is one.
//!
//! The other way round, a late state can meet a question for the fault. Of a motor that has sent a report of that shape
//! before, nothing else is a report. Of another, an answer that continues the last state is taken for a late state: on a
//! machine that reads every reply one cycle late, nothing else tells them apart. Bytes that mean nothing could make a report
//! look so, too: after three questions in a row without a report, the next answer is believed, unless a request was
//! left unanswered just before.
//!
//! Nothing here allocates, blocks or loops.

mod gim;
mod mit;

use crate::control::{Command, Heard};
use crate::joint::Impedance;
use crate::settings::{Capabilities, MotorProtocol, MotorSettings};
use motord_bus::{Duration, Frame, FrameId, Instant};
use motord_shared::SetpointMode;

/// What a frame turned out to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Answer {
    /// An answer, and what it says.
    Heard(Heard),
    /// Nobody asked.
    Duplicate,
    /// It bears the id of another motor.
    UnexpectedId,
    /// It does not decode, or does not answer what was asked.
    Malformed,
}

/// The abilities of motors that speak `protocol` (MIT document 1.1: positions of ±12.5 rad; GIM document 3.2.12: a stop is
/// answered by a message of its own).
#[must_use]
pub const fn capabilities(protocol: MotorProtocol) -> Capabilities {
    match protocol {
        MotorProtocol::Mit => {
            Capabilities { impedance: true, position_end: Some(12.5), state_confirms_stop: true }
        }
        MotorProtocol::Gim => {
            Capabilities { impedance: false, position_end: None, state_confirms_stop: false }
        }
    }
}

/// The frames that damp and stop a motor when nobody controls it any more. In native mode damping is made of the last
/// state, which nobody knows then: such a motor is stopped at once.
#[must_use]
pub fn safe_frames(motor: &MotorSettings) -> Option<(Frame, Frame)> {
    let make = |command| Drive::new(motor, Duration::ZERO, false).ask(&command, Instant::ZERO);
    let stop = make(Command::Stop)?;
    let damping = Impedance::new(0.0, 0.0, 0.0, motor.damping_kd, 0.0);
    let damp = match motor.protocol {
        MotorProtocol::Mit => make(Command::Control(damping, SetpointMode::Impedance))?,
        MotorProtocol::Gim => stop,
    };
    Some((damp, stop))
}

/// What was asked and not yet answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Open {
    at: Instant,
    asks_fault: bool,
}

/// One drive.
#[derive(Debug)]
pub struct Drive {
    command_id: FrameId,
    dialect: Dialect,
    fastest_answer: Duration,
    open: Option<Open>,
    /// Requests that were not answered in their cycle, as long as their answers may still come.
    owed: u32,
    owed_since: Instant,
    /// Until then, the next answer is dropped unless it is a fault report.
    drop_until: Instant,
    /// Questions for the fault in a row that no report came to in their cycle.
    unreported: u32,
    /// It has sent a report that no state looks like.
    has_reported: bool,
}

/// An answer that is later than this never comes.
const LATEST_ANSWER: Duration = Duration::from_millis(50);
/// After so many questions for the fault without a report, what looks like a state may be one.
const POLLS_MAX: u32 = 3;

#[derive(Debug)]
enum Dialect {
    Mit(mit::Mit),
    Gim(gim::Gim),
}

impl Drive {
    /// `fastest_answer` is the time that command and reply need at least on this bus; zero where it is not known.
    #[must_use]
    pub fn new(settings: &MotorSettings, fastest_answer: Duration, error_feedback: bool) -> Self {
        let transmission = settings.transmission;
        let command_id = FrameId::new(u16::from(settings.id)).expect("a motor id has eight bits");
        let dialect = match settings.protocol {
            MotorProtocol::Mit => Dialect::Mit(mit::Mit::new(settings, transmission, error_feedback)),
            MotorProtocol::Gim => Dialect::Gim(gim::Gim::new(settings.torque_scale, transmission)),
        };
        Self {
            command_id,
            dialect,
            fastest_answer,
            open: None,
            owed: 0,
            owed_since: Instant::ZERO,
            drop_until: Instant::ZERO,
            unreported: 0,
            has_reported: false,
        }
    }

    /// The frame for `command`, sent at `now`; `None` for [`Command::Nothing`]. Opens a request.
    pub fn ask(&mut self, command: &Command, now: Instant) -> Option<Frame> {
        let bytes = match &mut self.dialect {
            Dialect::Mit(mit) => mit.encode(command),
            Dialect::Gim(gim) => gim.encode(command),
        }?;
        match self.open {
            Some(open) if now.since(open.at) <= LATEST_ANSWER => {
                self.owed = self.owed.saturating_add(1);
                self.owed_since = now;
            }
            _ if now.since(self.owed_since) > LATEST_ANSWER => self.owed = 0,
            _ => {}
        }
        if let Some(open) = self.open.filter(|open| open.asks_fault) {
            self.drop_until = open.at + LATEST_ANSWER;
            self.unreported = self.unreported.saturating_add(1);
        }
        self.open = Some(Open { at: now, asks_fault: *command == Command::GetFault });
        Some(Frame::full(self.command_id, bytes))
    }

    /// The frame was not sent after all.
    pub fn unask(&mut self) {
        self.open = None;
    }

    /// An answer is awaited.
    #[must_use]
    pub const fn is_open(&self) -> bool {
        self.open.is_some()
    }

    /// What `payload` says, which arrived at `at` under this drive's reply id.
    pub fn read(&mut self, payload: &[u8], at: Instant) -> Answer {
        if self.is_from_another(payload) {
            return Answer::UnexpectedId;
        }
        if at < self.drop_until
            && !self.open.is_some_and(|open| open.asks_fault)
            && let Some(report) = self.report(payload)
        {
            self.unreported = 0;
            self.has_reported = true;
            self.read_late();
            return Answer::Heard(report);
        }
        let Some(open) = self.open.filter(|open| at >= open.at + self.fastest_answer) else {
            return self.read_unasked();
        };
        let latency = at.since(open.at);
        let answer = match &mut self.dialect {
            Dialect::Mit(mit) => mit.decode(payload, at, latency),
            Dialect::Gim(gim) => gim.decode(payload, latency),
        };
        if open.asks_fault && matches!(answer, Answer::Heard(_)) {
            let is_certain = self.report(payload).is_some();
            if !is_certain && self.is_rather_a_state(payload, at) {
                return self.read_late();
            }
            self.has_reported |= is_certain;
        }
        if matches!(answer, Answer::Heard(_)) {
            if at < self.drop_until {
                // A second question for the fault is given up with the first, or every next one would be.
                self.open = self.open.filter(|open| !open.asks_fault);
                return self.read_unasked();
            }
            self.open = None;
            if open.asks_fault {
                self.unreported = 0;
            }
        }
        answer
    }

    /// It answers an earlier request, if one was not answered yet; else something answers twice.
    fn read_unasked(&mut self) -> Answer {
        if self.owed > 0 {
            return self.read_late();
        }
        self.drop_until = Instant::ZERO;
        Answer::Duplicate
    }

    /// It answers an earlier request.
    const fn read_late(&mut self) -> Answer {
        self.drop_until = Instant::ZERO;
        self.owed = self.owed.saturating_sub(1);
        Answer::Heard(Heard::Late)
    }

    /// Natively an answer does not say who gave it.
    fn is_from_another(&self, payload: &[u8]) -> bool {
        match &self.dialect {
            Dialect::Mit(mit) => mit.is_from_another(payload),
            Dialect::Gim(_) => false,
        }
    }

    /// The fault report that `payload` is beyond doubt. Natively an answer names its question.
    fn report(&self, payload: &[u8]) -> Option<Heard> {
        match &self.dialect {
            Dialect::Mit(mit) => mit.report(payload),
            Dialect::Gim(_) => None,
        }
    }

    /// An answer to a question for the fault that is no certain report: more likely a late one to another.
    fn is_rather_a_state(&self, payload: &[u8], at: Instant) -> bool {
        let doubted = self.owed > 0 || self.unreported < POLLS_MAX;
        self.has_reported || doubted && self.continues(payload, at)
    }

    /// Natively an answer names its question.
    fn continues(&self, payload: &[u8], at: Instant) -> bool {
        match &self.dialect {
            Dialect::Mit(mit) => mit.continues(payload, at),
            Dialect::Gim(_) => false,
        }
    }
}
