//! Finds the request that a reply answers.
//!
//! An MIT reply does not name its request: a state and a fault report look alike, and a late reply
//! looks like a timely one (docs/adr/0005). A motor therefore has at most one open request. A reply
//! is judged by the open request, by its shape as the dialect ([`Payload`]) classifies it, and by
//! its time.
//!
//! Pure: a transition depends on state, payload and time only. Constant time; no allocation, no
//! system call.

use motord_bus::time::nanos;
use motord_bus::{Duration, Instant};

/// No reply arrives later than this.
pub(crate) const LATEST_REPLY: Duration = Duration::from_millis(50);
/// After this many fault requests without a report, a payload that continues the motion may be a
/// report.
const UNREPORTED_MAX: u32 = 3;
/// After this many fault requests without a report, even a motor that sent an unambiguous report
/// may answer with another kind of report: its fault may set bits that no document names.
const DOUBTED_AFTER: u32 = 10;
/// Most unanswered requests that are remembered. It bounds how many replies of a second motor with
/// the same id are taken for late ones.
const UNPAID_MAX: u32 = 100;
/// A report that arrives at least this many requests after its own proves that answers are late.
const BEHIND_REQUESTS: u32 = 3;
/// After this many such reports in a row the states of the motor are late. One follows any stall.
const BEHIND_REPORTS: u32 = 2;
/// For this time after the proof no state is an answer: longer than any `motor-lost` takes.
const BEHIND_TIME: Duration = Duration::from_secs(1);

/// The content that a request asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Question {
    /// The state: every command but the next two. A GIM motor may confirm such a command without a
    /// state.
    State,
    /// The fault bits.
    Fault,
    /// The confirmation that the motor received the request to clear its fault.
    Clear,
}

/// The kind of a payload, judged by its bytes alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Payload {
    /// It has the id of another motor.
    OtherId,
    /// It is no reply, or it names another request than the open one.
    Unreadable,
    /// An unambiguous fault report: no state has its shape.
    Report,
    /// Read as a state, it continues the last state. It may be a fault report by chance.
    Continuation,
    /// Any other reply.
    Plain,
}

/// The role of a payload, judged by its bytes and by the requests that were sent before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// The answer to the open request, and the time since that was sent.
    Answer(Question, Duration),
    /// A fault report, which answers an earlier fault request.
    LateReport,
    /// Answers an earlier request. Its content is unknown or outdated.
    Late,
    /// Answers no request.
    Duplicate,
    /// It is no reply, or cannot be an answer to the open request.
    Malformed,
    /// Comes from another motor.
    UnexpectedId,
}

/// The request that is open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Request {
    question: Question,
    sent_at: Instant,
}

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

/// The state of the correlation: six independent parts.
///
/// ```text
///   open             ┌──────── answer, withdrawal ◀────────┐
///                    ▼                                     │
///                 Nothing ──── request ──▶ State | Fault | Clear ──┐
///                                                  ▲               │ request: the one before is owed,
///                                                  └───────────────┘ if it is younger than 50 ms
///
///   owed             0 ◀── late or unasked reply ── n ◀── request while one is open (n + 1)
///                    ▲                              │
///                    └── request, 50 ms later ◀─────┘
///
///   unpaid           0 ◀── late or unasked reply ── n ◀── request while one is open (n + 1, up to
///                                                         UNPAID_MAX); time does not change it
///
///   reports_behind   0 ◀── report in time ── n ◀── report BEHIND_REQUESTS after its request (n + 1)
///                                            n = BEHIND_REPORTS: no state is an answer for BEHIND_TIME
///
///   trust            Trusted ── request while Fault is open ──▶ Distrusted until its sending + 50 ms
///                       ▲                                          │
///                       └── the next reply, which is dropped ◀─────┘
///
///   reports          Unseen(n) ── an unambiguous report ──▶ Seen(0)
///                       ▲                                   │
///                       └─────── n = DOUBTED_AFTER ── Seen(n)
///                      n + 1: request while Fault is open;  0: a fault request was answered
/// ```
///
/// | open | payload | trusted | distrusted |
/// |---|---|---|---|
/// | nothing, or sent too short ago | a report, Fault is not open | unasked | late report |
/// | nothing, or sent too short ago | any other | unasked | unasked |
/// | any | unreadable | malformed | malformed |
/// | State | report, while replies are owed | late report | late report |
/// | State | report | malformed | late report |
/// | State | continuation, plain, until `behind_until` | late | late |
/// | State | continuation, plain | answer | unasked |
/// | Clear | report | answer | late report |
/// | Clear | continuation, plain | answer | unasked |
/// | Fault | report | answer | given up |
/// | Fault | continuation, once a report was seen, or while replies are owed or n < 3 | late | late |
/// | Fault | plain, once a report was seen | late | late |
/// | Fault | any other | answer | given up |
///
/// *Unasked* is late while replies are owed or unpaid, otherwise a duplicate. *Given up* is unasked, and
/// closes the request: otherwise each fault request would be distrusted because of the previous
/// one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Correlator {
    /// Least time from a request to its reply, ns.
    fastest_reply: u64,
    open: Option<Request>,
    /// Requests that were not answered before the next, and whose replies may still arrive.
    owed: u32,
    owed_since: Instant,
    /// Requests that were not answered before the next, however long ago, less the replies that
    /// were late or unasked: no more replies than these can still be late.
    unpaid: u32,
    /// Requests since the last fault request, whose report did not arrive before the next.
    since_fault: Option<u32>,
    /// Consecutive reports [`BEHIND_REQUESTS`] or more after their requests.
    reports_behind: u32,
    /// Until this time every state is late.
    behind_until: Instant,
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
            owed: 0,
            owed_since: Instant::ZERO,
            unpaid: 0,
            since_fault: None,
            reports_behind: 0,
            behind_until: Instant::ZERO,
            distrusted_until: Instant::ZERO,
            reports: Reports::Unseen(0),
        }
    }

    /// Returns whether a request is open.
    pub(super) const fn is_open(&self) -> bool {
        self.open.is_some()
    }

    /// Returns the question of the open request.
    #[inline]
    pub(super) const fn question(&self) -> Option<Question> {
        match self.open {
            Some(open) => Some(open.question),
            None => None,
        }
    }

    /// Opens a request that is sent at `now`. Gives up the previous one, if it is still open.
    pub(super) fn request(&mut self, question: Question, now: Instant) {
        match self.open {
            Some(open) if now <= open.sent_at + LATEST_REPLY => {
                self.owed = self.owed.saturating_add(1);
                self.owed_since = now;
            }
            _ if now > self.owed_since + LATEST_REPLY => self.owed = 0,
            _ => {}
        }
        if self.open.is_some() {
            self.unpaid = (self.unpaid + 1).min(UNPAID_MAX);
        }
        if let Some(requests) = &mut self.since_fault {
            *requests = requests.saturating_add(1);
        }
        if let Some(Request { question: Question::Fault, sent_at }) = self.open {
            self.since_fault = Some(1);
            self.distrusted_until = sent_at + LATEST_REPLY;
            self.reports = self.reports.unreported();
        }
        self.open = Some(Request { question, sent_at: now });
    }

    /// Withdraws the open request, whose frame was not sent.
    pub(super) const fn withdraw(mut self) -> Self {
        self.open = None;
        self
    }

    /// Judges a payload that arrived at `at`.
    #[inline(always)]
    pub(super) fn receive(&mut self, payload: Payload, at: Instant) -> Role {
        let asks_fault = self.open.is_some_and(|open| open.question == Question::Fault);
        if payload == Payload::Report && !asks_fault {
            self.place_report(at);
        }
        match payload {
            Payload::OtherId => Role::UnexpectedId,
            Payload::Report if at < self.distrusted_until && !asks_fault => self.late_report(),
            _ => match self.open {
                Some(open) if self.may_answer(open, at) => self.judge(open, payload, at),
                _ => self.unasked(),
            },
        }
    }

    /// Counts the requests from a fault request to its report. They are the answers that this motor
    /// owes all the time: a lost reply delays no report.
    #[cold]
    fn place_report(&mut self, at: Instant) {
        let Some(requests) = self.since_fault.take() else { return };
        if requests < BEHIND_REQUESTS {
            self.reports_behind = 0;
            return;
        }
        self.reports_behind = (self.reports_behind + 1).min(BEHIND_REPORTS);
        if self.reports_behind == BEHIND_REPORTS {
            self.behind_until = at + BEHIND_TIME;
        }
    }

    /// Returns whether a payload that arrived at `at` can have been sent after the request.
    const fn may_answer(&self, open: Request, at: Instant) -> bool {
        at.as_nanos() >= open.sent_at.as_nanos().saturating_add(self.fastest_reply)
    }

    /// Judges a payload that may answer the open request.
    #[inline(always)]
    fn judge(&mut self, open: Request, payload: Payload, at: Instant) -> Role {
        match (open.question, payload) {
            (Question::State, Payload::Report) if self.owed > 0 => self.late_report(),
            (_, Payload::Unreadable) | (Question::State, Payload::Report) => Role::Malformed,
            (Question::Fault, Payload::Continuation | Payload::Plain) if self.is_rather_a_state(payload) => {
                self.late()
            }
            (Question::State, _) if at < self.behind_until => self.late(),
            (Question::Fault, Payload::Report) => {
                self.reports = Reports::Seen(0);
                if self.since_fault.take().is_none() {
                    self.reports_behind = 0;
                }
                self.answer(open, at)
            }
            _ => self.answer(open, at),
        }
    }

    /// Takes the payload as the answer to the open request, unless the next reply is distrusted.
    fn answer(&mut self, open: Request, at: Instant) -> Role {
        let is_fault = open.question == Question::Fault;
        if at < self.distrusted_until {
            self.open = self.open.filter(|_| !is_fault);
            return self.unasked();
        }
        self.open = None;
        if is_fault && matches!(self.reports, Reports::Unseen(_)) {
            self.reports = Reports::Unseen(0);
        }
        Role::Answer(open.question, at.since(open.sent_at))
    }

    const fn late_report(&mut self) -> Role {
        self.reports = Reports::Seen(0);
        let _late = self.late();
        Role::LateReport
    }

    const fn late(&mut self) -> Role {
        self.distrusted_until = Instant::ZERO;
        self.owed = self.owed.saturating_sub(1);
        self.unpaid = self.unpaid.saturating_sub(1);
        Role::Late
    }

    const fn unasked(&mut self) -> Role {
        if self.owed > 0 || self.unpaid > 0 {
            return self.late();
        }
        self.distrusted_until = Instant::ZERO;
        Role::Duplicate
    }

    /// Returns whether an ambiguous answer to a fault request is more likely a late state.
    const fn is_rather_a_state(&self, payload: Payload) -> bool {
        match self.reports {
            Reports::Seen(_) => true,
            Reports::Unseen(unreported) => {
                matches!(payload, Payload::Continuation) && (self.owed > 0 || unreported < UNREPORTED_MAX)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Payload::{Continuation, OtherId, Plain, Report, Unreadable};
    use Question::{Clear, Fault, State};

    fn asked(mut state: Correlator, question: Question, at: Instant) -> Correlator {
        state.request(question, at);
        state
    }

    /// The state and the role after a payload.
    fn received(mut state: Correlator, payload: Payload, at: Instant) -> (Correlator, Role) {
        let role = state.receive(payload, at);
        (state, role)
    }

    const SENT: Instant = Instant::from_nanos(1_000_000_000);
    const FASTEST: Duration = Duration::from_micros(200);

    /// The role on a payload, and its effect on the state of the correlator.
    #[derive(Debug, Clone, Copy, PartialEq)]
    enum Outcome {
        /// The answer: closes the request.
        Ans,
        /// Late while replies are owed, else a duplicate. Ends distrust.
        Una,
        /// The same, and closes the request.
        Giv,
        /// Late, owed or not. Ends distrust.
        Lat,
        /// A late report. Ends distrust.
        Rep,
        /// Malformed: changes nothing.
        Mal,
    }
    use Outcome::{Ans, Giv, Lat, Mal, Rep, Una};

    #[derive(Debug, Clone, Copy, PartialEq)]
    enum Time {
        /// Before the wire can carry request and reply.
        Soon,
        Timely,
    }
    use Time::{Soon, Timely};

    const FEW: Reports = Reports::Unseen(UNREPORTED_MAX - 1);
    const MANY: Reports = Reports::Unseen(UNREPORTED_MAX);
    const SEEN: Reports = Reports::Seen(0);

    /// Which states and times, as (open, reports, owed, distrusted, time), where `ANY…` is every one; then what becomes of each
    /// kind of payload.
    type Row = (Option<Question>, &'static [Reports], &'static [u32], bool, &'static [Time], [Outcome; 4]);
    const ANY: &[Reports] = &[FEW, MANY, SEEN];
    const ANY_OWED: &[u32] = &[0, 1, 2];
    const ANY_TIME: &[Time] = &[Soon, Timely];
    const PAYLOADS: [Payload; 4] = [Unreadable, Report, Continuation, Plain];
    #[rustfmt::skip]
    const TABLE: [Row; 21] = [
        // open,        reports,  owed,     distrusted, time,      unreadable, report, continuation, plain
        (None,          ANY,      ANY_OWED, false,      ANY_TIME,  [Una,       Una,    Una,          Una]),
        (None,          ANY,      ANY_OWED, true,       ANY_TIME,  [Una,       Rep,    Una,          Una]),
        (Some(State),   ANY,      ANY_OWED, false,      &[Soon],   [Una,       Una,    Una,          Una]),
        (Some(State),   ANY,      ANY_OWED, true,       &[Soon],   [Una,       Rep,    Una,          Una]),
        (Some(State),   ANY,      &[0],     false,      &[Timely], [Mal,       Mal,    Ans,          Ans]),
        (Some(State),   ANY,      &[1, 2],  false,      &[Timely], [Mal,       Rep,    Ans,          Ans]),
        (Some(State),   ANY,      ANY_OWED, true,       &[Timely], [Mal,       Rep,    Una,          Una]),
        (Some(Clear),   ANY,      ANY_OWED, false,      &[Soon],   [Una,       Una,    Una,          Una]),
        (Some(Clear),   ANY,      ANY_OWED, true,       &[Soon],   [Una,       Rep,    Una,          Una]),
        (Some(Clear),   ANY,      ANY_OWED, false,      &[Timely], [Mal,       Ans,    Ans,          Ans]),
        (Some(Clear),   ANY,      ANY_OWED, true,       &[Timely], [Mal,       Rep,    Una,          Una]),
        (Some(Fault),   ANY,      ANY_OWED, false,      &[Soon],   [Una,       Una,    Una,          Una]),
        (Some(Fault),   ANY,      ANY_OWED, true,       &[Soon],   [Una,       Una,    Una,          Una]),
        (Some(Fault),   &[FEW],   ANY_OWED, false,      &[Timely], [Mal,       Ans,    Lat,          Ans]),
        (Some(Fault),   &[FEW],   ANY_OWED, true,       &[Timely], [Mal,       Giv,    Lat,          Giv]),
        (Some(Fault),   &[MANY],  &[0],     false,      &[Timely], [Mal,       Ans,    Ans,          Ans]),
        (Some(Fault),   &[MANY],  &[0],     true,       &[Timely], [Mal,       Giv,    Giv,          Giv]),
        (Some(Fault),   &[MANY],  &[1, 2],  false,      &[Timely], [Mal,       Ans,    Lat,          Ans]),
        (Some(Fault),   &[MANY],  &[1, 2],  true,       &[Timely], [Mal,       Giv,    Lat,          Giv]),
        (Some(Fault),   &[SEEN],  ANY_OWED, false,      &[Timely], [Mal,       Ans,    Lat,          Lat]),
        (Some(Fault),   &[SEEN],  ANY_OWED, true,       &[Timely], [Mal,       Giv,    Lat,          Lat]),
    ];

    /// Every state that the table distinguishes, each with both times.
    fn every_state() -> impl Iterator<Item = (Correlator, Time)> {
        let opens = [None, Some(State), Some(Clear), Some(Fault)];
        let open_reports = opens.into_iter().flat_map(|open| ANY.iter().map(move |&reports| (open, reports)));
        let owed = open_reports.flat_map(|state| ANY_OWED.iter().map(move |&owed| (state, owed)));
        let trust = owed.flat_map(|state| [false, true].map(|distrusted| (state, distrusted)));
        let unpaid = trust.flat_map(|state| [0, 1].map(|unpaid| (state, unpaid)));
        let times = unpaid.flat_map(|state| ANY_TIME.iter().map(move |&time| (state, time)));
        times.map(|(((((question, reports), owed), distrusted), unpaid), time)| {
            let open = question.map(|question| Request { question, sent_at: SENT });
            let distrusted_until = if distrusted { SENT + LATEST_REPLY } else { SENT };
            let state = Correlator {
                open,
                reports,
                owed,
                unpaid,
                distrusted_until,
                owed_since: SENT,
                ..Correlator::new(FASTEST)
            };
            (state, time)
        })
    }

    /// The rows that speak of this state at this time.
    fn rows(state: &Correlator, time: Time) -> Vec<&'static Row> {
        let is_distrusted = state.distrusted_until > SENT;
        let speaks = |(open, reports, owed, distrusted, times, _): &&Row| {
            *open == state.open.map(|open| open.question)
                && reports.contains(&state.reports)
                && owed.contains(&state.owed)
                && *distrusted == is_distrusted
                && times.contains(&time)
        };
        TABLE.iter().filter(speaks).collect()
    }

    /// The state and the role that an outcome means.
    fn expected(outcome: Outcome, before: Correlator, at: Instant) -> (Correlator, Role) {
        let late = |role| {
            let (owed, unpaid) = (before.owed.saturating_sub(1), before.unpaid.saturating_sub(1));
            (Correlator { owed, unpaid, distrusted_until: Instant::ZERO, ..before }, role)
        };
        let unasked =
            || late(if before.owed > 0 || before.unpaid > 0 { Role::Late } else { Role::Duplicate });
        let closed = |(state, role)| (Correlator { open: None, ..state }, role);
        match outcome {
            Mal => (before, Role::Malformed),
            Lat => late(Role::Late),
            Rep => late(Role::LateReport),
            Una => unasked(),
            Giv => closed(unasked()),
            Ans => {
                let Request { question, sent_at } = before.open.expect("it answers a request");
                closed((before, Role::Answer(question, at.since(sent_at))))
            }
        }
    }

    /// The value of `reports` after the payload.
    fn expected_reports(outcome: Outcome, before: Correlator, payload: Payload) -> Reports {
        let answers_fault = before.open.is_some_and(|open| open.question == Fault);
        match (outcome, payload) {
            (Rep, _) => SEEN,
            (Ans | Giv, Report) if answers_fault => SEEN,
            (Ans, _) if answers_fault && before.reports != SEEN => Reports::Unseen(0),
            _ => before.reports,
        }
    }

    /// Goal: every payload in every state at every time has the role that the table says, and leaves the state it says.
    /// Method: all states that differ in any column, each looked up in the table; exactly one row speaks of each.
    #[test]
    fn every_payload_in_every_state_matches_the_table() {
        for (before, time) in every_state() {
            let at = if time == Soon { SENT + FASTEST / 2 } else { SENT + FASTEST };
            let rows = rows(&before, time);
            assert_eq!(rows.len(), 1, "{before:?}, {time:?}: {rows:?}");
            for (payload, outcome) in PAYLOADS.into_iter().zip(rows[0].5) {
                let (mut state, role) = expected(outcome, before, at);
                state.reports = expected_reports(outcome, before, payload);
                assert_eq!(received(before, payload, at), (state, role), "{before:?}, {payload:?}, {time:?}");
            }
            assert_eq!(received(before, OtherId, at), (before, Role::UnexpectedId));
        }
    }

    #[test]
    fn new_request_leaves_the_open_one_owed() {
        let open = asked(Correlator::new(FASTEST), State, SENT);
        assert_eq!((open.owed, open.is_open()), (0, true));
        let in_time = asked(open, State, SENT + LATEST_REPLY);
        assert_eq!((in_time.owed, in_time.owed_since), (1, SENT + LATEST_REPLY));
        let nanosecond = Duration::from_nanos(1);
        assert_eq!(asked(open, State, SENT + LATEST_REPLY + nanosecond).owed, 0);
        let idle = in_time.withdraw();
        assert_eq!(asked(idle, State, in_time.owed_since + LATEST_REPLY).owed, 1);
        assert_eq!(asked(idle, State, in_time.owed_since + LATEST_REPLY + nanosecond).owed, 0);
    }

    #[test]
    fn request_after_unanswered_fault_request_is_distrusted() {
        let unanswered = asked(Correlator::new(FASTEST), Fault, SENT);
        let state = asked(unanswered, State, SENT + Duration::from_millis(1));
        assert_eq!((state.distrusted_until, state.reports), (SENT + LATEST_REPLY, Reports::Unseen(1)));
        let just_before = SENT + LATEST_REPLY - Duration::from_nanos(1);
        assert_eq!(received(state, Plain, just_before).1, Role::Late);
        assert!(matches!(received(state, Plain, SENT + LATEST_REPLY).1, Role::Answer(State, _)));
        let trusted = asked(asked(Correlator::new(FASTEST), State, SENT), State, SENT + LATEST_REPLY);
        assert_eq!(trusted.distrusted_until, Instant::ZERO);
    }

    #[test]
    fn motor_with_shapeless_reports_is_believed_after_ten() {
        let after = |requests: u32| {
            let seen = Correlator { reports: SEEN, ..Correlator::new(FASTEST) };
            (0..requests).fold(seen, |state, _| asked(state, Fault, SENT))
        };
        let reports = |requests| after(requests).reports;
        assert_eq!(reports(DOUBTED_AFTER), Reports::Seen(DOUBTED_AFTER - 1));
        assert_eq!(reports(DOUBTED_AFTER + 1), Reports::Unseen(DOUBTED_AFTER));
        let later = SENT + LATEST_REPLY;
        let role = |requests| received(after(requests), Plain, later).1;
        assert_eq!(role(DOUBTED_AFTER), Role::Late);
        assert!(matches!(role(DOUBTED_AFTER + 1), Role::Answer(Fault, _)));
    }

    /// Goal: no more replies are called late than requests were unanswered, however late, and a second motor with the same
    /// id is still found. Method: `missed` silent turns of `period`; then two replies to each request.
    #[test]
    fn surplus_replies_are_late_while_requests_are_unanswered() {
        for period in [1, 20, 100].map(Duration::from_millis) {
            for missed in [0, 1, 12, UNPAID_MAX, 10 * UNPAID_MAX] {
                let (mut state, mut at) = (Correlator::new(FASTEST), SENT);
                for _ in 0..missed {
                    state.request(State, at);
                    at = at + period;
                }
                // Answered turns between the silence and the burst, and more than 50 ms.
                for _ in 0..100 {
                    state.request(State, at);
                    assert!(matches!(state.receive(Plain, at + FASTEST), Role::Answer(State, _)));
                    at = at + period;
                }
                let surplus: Vec<_> = (0..2 * UNPAID_MAX).map(|_| state.receive(Plain, at)).collect();
                let late = missed.min(UNPAID_MAX) as usize;
                assert!(surplus[..late].iter().all(|role| *role == Role::Late), "{period:?}, {missed}");
                assert!(surplus[late..].iter().all(|role| *role == Role::Duplicate), "{period:?}, {missed}");
            }
        }
    }

    /// Method: a queue of answers that is `lag` long; or as many lost replies, and timely answers since.
    #[test]
    fn reports_behind_their_requests_make_states_late() {
        for (lag, lost) in [(0, 0), (1, 0), (2, 0), (3, 0), (30, 0), (0, 7)] {
            let (mut state, mut queue, mut late) = (Correlator::new(FASTEST), Vec::new(), 0);
            for turn in 0..1000_u32 {
                let question = if turn % 100 == 50 { Fault } else { State };
                let at = SENT + Duration::from_millis(3) * turn;
                state.request(question, at);
                queue.extend((turn >= lost).then_some(if question == Fault { Report } else { Continuation }));
                if queue.len() > lag {
                    late += u32::from(state.receive(queue.remove(0), at + FASTEST) == Role::Late);
                }
            }
            assert_eq!(late > 500, lag > 2, "{lag} behind, {lost} lost: {late}");
        }
    }

    #[test]
    fn unsent_request_leaves_nothing_open() {
        let before = Correlator::new(FASTEST);
        assert_eq!(asked(before, Fault, SENT).withdraw(), before);
    }
}
