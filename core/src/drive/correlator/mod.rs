//! Finds the request that a reply answers.
//!
//! An MIT reply does not name its request: a state and a fault report look alike, and a late reply
//! looks like a timely one (docs/adr/0005). A motor therefore has at most one open request. A reply
//! is classified by the open request, by its [`Shape`], as the dialect classifies it, and by
//! its time.
//!
//! Pure: a transition depends on state, payload and time only. Constant time; no allocation, no
//! system call.

#[cfg(test)]
mod tests;

use motord_bus::time::nanos;
use motord_bus::{Duration, Instant};
use motord_protocol::drive::{Question, Shape};

/// No reply arrives later than this.
pub(crate) const LATEST_REPLY: Duration = Duration::from_millis(50);
/// Most unanswered requests that are remembered. It bounds how many replies of a second motor with
/// the same id are taken for late ones.
const UNANSWERED_MAX: u32 = 100;

/// The request that is open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Request {
    question: Question,
    sent_at: Instant,
}

/// The state of the correlation: five independent parts.
///
/// ```text
///   open             ┌── answer, ambiguous, withdrawal ◀───┐
///                    ▼                                     │
///                 Nothing ── request ──▶ State | Fault | Clear | Register ──┐
///                                                  ▲               │ request: the one before is pending,
///                                                  └───────────────┘ if it is younger than 50 ms
///
///   pending          0 ◀── late or unasked reply ── n ◀── request while one is open, or an ambiguous answer
///                    ▲                              │     (n + 1)
///                    └── request, 50 ms later ◀─────┘
///
///   unanswered       0 ◀── late or unasked reply ── n ◀── request while one is open (n + 1, up to
///                                                         UNANSWERED_MAX); time does not change it
///
///   trust            Trusted ── request while Fault is open ──▶ Distrusted until its sending + 50 ms
///                       ▲                                          │
///                       └── the next reply, which is dropped ◀─────┘
///
///   reports          Unseen(n) ── an unambiguous report ──▶ Seen(0)
///                       ▲                                   │
///                       └─────── n = DOUBTED_AFTER ── Seen(n)
///                      n + 1: request while Fault is open
/// ```
///
/// | open | payload | trusted | distrusted |
/// |---|---|---|---|
/// | any | unprompted | unprompted: changes nothing | the same |
/// | nothing, or sent too short ago | a report, Fault is not open | unasked | late report |
/// | nothing, or sent too short ago | any other | unasked | unasked |
/// | any | unreadable | malformed | malformed |
/// | any but Register, or sent too short ago | register | late register while replies are pending, late while they are unanswered, otherwise malformed | the same |
/// | Register | register | answer | unasked |
/// | Register | report, continuation, plain | unasked | unasked |
/// | State | report, while replies are pending | late report | late report |
/// | State | report | malformed | late report |
/// | State | continuation, plain | answer | unasked |
/// | Clear | report | answer | late report |
/// | Clear | continuation, plain | answer | unasked |
/// | Fault | report | answer | given up |
/// | Fault | continuation, once a report was seen, or while replies are pending or n < 3 | late | late |
/// | Fault | plain, once a report was seen | late | late |
/// | Fault | any other | ambiguous | given up |
///
/// *Ambiguous*: the report may still be on its way behind this late state, so it is pending.
/// *Unasked* is late while replies are pending or unanswered, otherwise a duplicate. *Given up* is
/// unasked, and closes the request: otherwise each fault request would be distrusted because of the
/// previous one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Correlator {
    /// Least time from a request to its reply, ns.
    fastest_reply: u64,
    open: Option<Request>,
    /// Requests that were not answered before the next, and whose replies may still arrive.
    pending: u32,
    pending_since: Instant,
    /// Requests that were not answered before the next, however long ago, less the replies that
    /// were late or unasked: no more replies than these can still be late.
    unanswered: u32,
    /// Until this time the next reply is dropped, except an unambiguous fault report while no fault
    /// request is open.
    distrusted_until: Instant,
    reports: Reports,
}

impl Correlator {
    /// Creates a correlator without an open request. No reply arrives earlier than `fastest_reply`
    /// after its request.
    pub(super) const fn new(fastest_reply: Duration) -> Self {
        Self {
            fastest_reply: nanos(fastest_reply),
            open: None,
            pending: 0,
            pending_since: Instant::ZERO,
            unanswered: 0,
            distrusted_until: Instant::ZERO,
            reports: Reports::Unseen(0),
        }
    }

    /// Returns whether a request is open.
    pub(super) const fn is_open(&self) -> bool {
        self.open.is_some()
    }

    /// Returns the question of the open request, if a payload that arrived at `at` can answer it.
    #[inline]
    pub(super) fn question(&self, at: Instant) -> Option<Question> {
        self.open.filter(|open| self.may_answer(*open, at)).map(|open| open.question)
    }

    /// Opens a request that is sent at `now`. Gives up the previous one, if it is still open.
    pub(super) fn request(&mut self, question: Question, now: Instant) {
        self.send(now);
        self.open = Some(Request { question, sent_at: now });
    }

    /// Sends a command that the motor does not answer, at `now`. Gives up the open request.
    pub(super) fn send(&mut self, now: Instant) {
        match self.open {
            Some(open) if now <= open.sent_at + LATEST_REPLY => {
                self.pending = self.pending.saturating_add(1);
                self.pending_since = now;
            }
            _ if now > self.pending_since + LATEST_REPLY => self.pending = 0,
            _ => {}
        }
        if self.open.is_some() {
            self.unanswered = (self.unanswered + 1).min(UNANSWERED_MAX);
        }
        if let Some(Request { question: Question::Fault, sent_at }) = self.open {
            self.distrusted_until = sent_at + LATEST_REPLY;
            self.reports = self.reports.unreported();
        }
        self.open = None;
    }

    /// Withdraws the open request, whose frame was not sent.
    pub(super) const fn withdraw(mut self) -> Self {
        self.open = None;
        self
    }

    /// Returns the time from the open request to `at`, if a plain payload that arrived at `at`
    /// answers it, and if it asks for a state.
    #[inline(always)]
    pub(super) fn state_latency(&self, at: Instant) -> Option<Duration> {
        let open = self.open.filter(|open| open.question == Question::State && self.may_answer(*open, at))?;
        (at >= self.distrusted_until).then(|| at.since(open.sent_at))
    }

    /// Classifies a payload that arrived at `at`.
    pub(super) fn receive(&mut self, shape: Shape, at: Instant) -> Role {
        let awaits_fault = self.open.is_some_and(|open| open.question == Question::Fault);
        match shape {
            Shape::OtherId => Role::UnexpectedId,
            Shape::Unprompted => Role::Unprompted,
            Shape::Register if !self.awaits_register(at) => self.unasked_register(),
            Shape::Report if at < self.distrusted_until && !awaits_fault => self.late_report(),
            _ => match self.open {
                Some(open) if self.may_answer(open, at) => self.classify(open, shape, at),
                _ => self.unasked(),
            },
        }
    }

    /// Returns whether a register that arrived at `at` may answer the open request.
    #[cold]
    fn awaits_register(&self, at: Instant) -> bool {
        self.open.is_some_and(|open| open.question == Question::Register && self.may_answer(open, at))
    }

    /// Classifies a register that answers no open request. It is late, or another program asked for
    /// it: no sign of a second motor.
    #[cold]
    const fn unasked_register(&mut self) -> Role {
        let is_pending = self.pending > 0;
        if !is_pending && self.unanswered == 0 {
            return Role::Malformed;
        }
        let late = self.late();
        if is_pending { Role::LateRegister } else { late }
    }

    /// Returns whether a payload that arrived at `at` can have been sent after the request.
    const fn may_answer(&self, open: Request, at: Instant) -> bool {
        at.as_nanos() >= open.sent_at.as_nanos().saturating_add(self.fastest_reply)
    }

    /// Classifies a payload that may answer the open request.
    fn classify(&mut self, open: Request, shape: Shape, at: Instant) -> Role {
        match (open.question, shape) {
            (Question::State, Shape::Report) if self.pending > 0 => self.late_report(),
            (_, Shape::Unreadable) | (Question::State, Shape::Report) => Role::Malformed,
            (Question::Register, Shape::Report | Shape::Continuation | Shape::Plain) => self.unasked(),
            (Question::Fault, Shape::Continuation | Shape::Plain) if self.is_rather_a_state(shape) => {
                self.late()
            }
            (Question::Fault, Shape::Report) => {
                self.reports = Reports::Seen(0);
                self.answer(open, at)
            }
            (Question::Fault, _) => self.ambiguous(at),
            _ => self.answer(open, at),
        }
    }

    /// Takes the payload as an answer that may be the late one to an earlier request, unless the
    /// next reply is distrusted.
    fn ambiguous(&mut self, at: Instant) -> Role {
        self.open = None;
        if at < self.distrusted_until {
            return self.unasked();
        }
        self.pending = self.pending.saturating_add(1);
        self.pending_since = at;
        Role::Ambiguous
    }

    /// Takes the payload as the answer to the open request, unless the next reply is distrusted.
    fn answer(&mut self, open: Request, at: Instant) -> Role {
        let is_fault = open.question == Question::Fault;
        if at < self.distrusted_until {
            self.open = self.open.filter(|_| !is_fault);
            return self.unasked();
        }
        self.open = None;
        Role::Answer(open.question, at.since(open.sent_at))
    }

    const fn late_report(&mut self) -> Role {
        self.reports = Reports::Seen(0);
        let _late = self.late();
        Role::LateReport
    }

    const fn late(&mut self) -> Role {
        self.distrusted_until = Instant::ZERO;
        self.pending = self.pending.saturating_sub(1);
        self.unanswered = self.unanswered.saturating_sub(1);
        Role::Late
    }

    const fn unasked(&mut self) -> Role {
        if self.pending > 0 || self.unanswered > 0 {
            return self.late();
        }
        self.distrusted_until = Instant::ZERO;
        Role::Duplicate
    }

    /// Returns whether an answer to a fault request is certainly, or more likely, a late state.
    const fn is_rather_a_state(&self, shape: Shape) -> bool {
        match self.reports {
            Reports::Seen(_) => true,
            Reports::Unseen(unreported) => {
                matches!(shape, Shape::Continuation) && (self.pending > 0 || unreported < UNREPORTED_MAX)
            }
        }
    }
}

/// The role of a payload, classified by its bytes and by the requests that were sent before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    /// The answer to the open request, and the time since that was sent.
    Answer(Question, Duration),
    /// An answer to the open fault request that may be a late state instead of a report.
    Ambiguous,
    /// A fault report, which answers an earlier fault request.
    LateReport,
    /// A register, which answers an earlier request: it names its number.
    LateRegister,
    /// Answers an earlier request. Its content is unknown or outdated.
    Late,
    /// Answers no request.
    Duplicate,
    /// The motor reports it by itself: it says nothing about requests.
    Unprompted,
    /// It is no reply, or cannot be an answer to the open request.
    Malformed,
    /// Comes from another motor.
    UnexpectedId,
}

/// After this many fault requests without a report, a payload that continues the motion may be a
/// report.
const UNREPORTED_MAX: u32 = 3;
/// After this many fault requests without a report, even a motor that sent an unambiguous report
/// may answer with another kind of report: its fault may set bits that no document names.
const DOUBTED_AFTER: u32 = 10;

/// How well the fault reports of this motor are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reports {
    /// No unambiguous report has arrived, or none recently. The number counts consecutive fault
    /// requests without an answer in their cycle.
    Unseen(u32),
    /// An unambiguous report has arrived. The number counts later consecutive fault requests
    /// without an answer in their cycle. No other payload is taken for a report until it reaches
    /// [`DOUBTED_AFTER`].
    Seen(u32),
}

impl Reports {
    /// Counts a fault request without an answer in its cycle.
    const fn unreported(self) -> Self {
        match self {
            Self::Seen(unreported) if unreported + 1 < DOUBTED_AFTER => Self::Seen(unreported + 1),
            Self::Seen(unreported) | Self::Unseen(unreported) => Self::Unseen(unreported.saturating_add(1)),
        }
    }
}
