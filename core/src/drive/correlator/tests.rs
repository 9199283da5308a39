//! Each state with each payload, and the counts over many turns.

use super::{DOUBTED_AFTER, *};
use Question::{Clear, Fault, State};
use Shape::{Continuation, OtherId, Plain, Report, Unreadable};

fn asked(mut state: Correlator, question: Question, at: Instant) -> Correlator {
    state.request(question, at);
    state
}

/// The state and the role after a payload.
fn received(mut state: Correlator, shape: Shape, at: Instant) -> (Correlator, Role) {
    let role = state.receive(shape, at);
    (state, role)
}

const SENT: Instant = Instant::from_nanos(1_000_000_000);
const FASTEST: Duration = Duration::from_micros(200);

/// The role on a payload, and its effect on the state of the correlator.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Outcome {
    /// The answer: closes the request.
    Ans,
    /// Late while replies are pending, else a duplicate. Ends distrust.
    Una,
    /// The same, and closes the request.
    Giv,
    /// Late, pending or not. Ends distrust.
    Lat,
    /// A late report. Ends distrust.
    Rep,
    /// Malformed: changes nothing.
    Mal,
    /// Ambiguous: closes the request, whose report is pending.
    Amb,
    /// Late while replies are pending, else malformed. Late, it ends distrust.
    Reg,
}
use Outcome::{Amb, Ans, Giv, Lat, Mal, Reg, Rep, Una};

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

/// Which states and times, as (open, reports, pending, distrusted, time), where `ANY…` is every
/// one; then what becomes of each kind of payload.
type Row = (Option<Question>, &'static [Reports], &'static [u32], bool, &'static [Time], [Outcome; 5]);
const ANY: &[Reports] = &[FEW, MANY, SEEN];
const ANY_PENDING: &[u32] = &[0, 1, 2];
const ANY_TIME: &[Time] = &[Soon, Timely];
const PAYLOADS: [Shape; 5] = [Unreadable, Report, Continuation, Plain, Shape::Register];
#[rustfmt::skip]
const TABLE: [Row; 25] = [
    // open, reports, pending, distrusted, time, unreadable, report, continuation, plain, register
    (None,          ANY,      ANY_PENDING, false,      ANY_TIME,  [Una,       Una,    Una,          Una, Reg]),
    (None,          ANY,      ANY_PENDING, true,       ANY_TIME,  [Una,       Rep,    Una,          Una, Reg]),
    (Some(State),   ANY,      ANY_PENDING, false,      &[Soon],   [Una,       Una,    Una,          Una, Reg]),
    (Some(State),   ANY,      ANY_PENDING, true,       &[Soon],   [Una,       Rep,    Una,          Una, Reg]),
    (Some(State),   ANY,      &[0],     false,      &[Timely], [Mal,       Mal,    Ans,          Ans, Reg]),
    (Some(State),   ANY,      &[1, 2],  false,      &[Timely], [Mal,       Rep,    Ans,          Ans, Reg]),
    (Some(State),   ANY,      ANY_PENDING, true,       &[Timely], [Mal,       Rep,    Una,          Una, Reg]),
    (Some(Clear),   ANY,      ANY_PENDING, false,      &[Soon],   [Una,       Una,    Una,          Una, Reg]),
    (Some(Clear),   ANY,      ANY_PENDING, true,       &[Soon],   [Una,       Rep,    Una,          Una, Reg]),
    (Some(Clear),   ANY,      ANY_PENDING, false,      &[Timely], [Mal,       Ans,    Ans,          Ans, Reg]),
    (Some(Clear),   ANY,      ANY_PENDING, true,       &[Timely], [Mal,       Rep,    Una,          Una, Reg]),
    (Some(Fault),   ANY,      ANY_PENDING, false,      &[Soon],   [Una,       Una,    Una,          Una, Reg]),
    (Some(Fault),   ANY,      ANY_PENDING, true,       &[Soon],   [Una,       Una,    Una,          Una, Reg]),
    (Some(Fault),   &[FEW],   ANY_PENDING, false,      &[Timely], [Mal,       Ans,    Lat,          Amb, Reg]),
    (Some(Fault),   &[FEW],   ANY_PENDING, true,       &[Timely], [Mal,       Giv,    Lat,          Giv, Reg]),
    (Some(Fault),   &[MANY],  &[0],     false,      &[Timely], [Mal,       Ans,    Amb,          Amb, Reg]),
    (Some(Fault),   &[MANY],  &[0],     true,       &[Timely], [Mal,       Giv,    Giv,          Giv, Reg]),
    (Some(Fault),   &[MANY],  &[1, 2],  false,      &[Timely], [Mal,       Ans,    Lat,          Amb, Reg]),
    (Some(Fault),   &[MANY],  &[1, 2],  true,       &[Timely], [Mal,       Giv,    Lat,          Giv, Reg]),
    (Some(Fault),   &[SEEN],  ANY_PENDING, false,      &[Timely], [Mal,       Ans,    Lat,          Lat, Reg]),
    (Some(Fault),   &[SEEN],  ANY_PENDING, true,       &[Timely], [Mal,       Giv,    Lat,          Lat, Reg]),
    (Some(Question::Register), ANY, ANY_PENDING, false, &[Soon],   [Una,       Una,    Una,          Una, Reg]),
    (Some(Question::Register), ANY, ANY_PENDING, true,  &[Soon],   [Una,       Rep,    Una,          Una, Reg]),
    (Some(Question::Register), ANY, ANY_PENDING, false, &[Timely], [Mal,       Una,    Una,          Una, Ans]),
    (Some(Question::Register), ANY, ANY_PENDING, true,  &[Timely], [Mal,       Rep,    Una,          Una, Una]),
];

/// Every state that the table distinguishes, each with both times.
fn every_state() -> impl Iterator<Item = (Correlator, Time)> {
    let opens = [None, Some(State), Some(Clear), Some(Fault), Some(Question::Register)];
    let open_reports = opens.into_iter().flat_map(|open| ANY.iter().map(move |&reports| (open, reports)));
    let pending = open_reports.flat_map(|state| ANY_PENDING.iter().map(move |&pending| (state, pending)));
    let trust = pending.flat_map(|state| [false, true].map(|distrusted| (state, distrusted)));
    let unanswered = trust.flat_map(|state| [0, 1].map(|unanswered| (state, unanswered)));
    let times = unanswered.flat_map(|state| ANY_TIME.iter().map(move |&time| (state, time)));
    times.map(|(((((question, reports), pending), distrusted), unanswered), time)| {
        let open = question.map(|question| Request { question, sent_at: SENT });
        let distrusted_until = if distrusted { SENT + LATEST_REPLY } else { SENT };
        let state = Correlator {
            open,
            reports,
            pending,
            unanswered,
            distrusted_until,
            pending_since: SENT,
            ..Correlator::new(FASTEST)
        };
        (state, time)
    })
}

/// The rows that speak of this state at this time.
fn rows(state: &Correlator, time: Time) -> Vec<&'static Row> {
    let is_distrusted = state.distrusted_until > SENT;
    let speaks = |(open, reports, pending, distrusted, times, _): &&Row| {
        *open == state.open.map(|open| open.question)
            && reports.contains(&state.reports)
            && pending.contains(&state.pending)
            && *distrusted == is_distrusted
            && times.contains(&time)
    };
    TABLE.iter().filter(speaks).collect()
}

/// The state and the role that an outcome means.
fn expected(outcome: Outcome, before: Correlator, at: Instant) -> (Correlator, Role) {
    let late = |role| {
        let (pending, unanswered) = (before.pending.saturating_sub(1), before.unanswered.saturating_sub(1));
        (Correlator { pending, unanswered, distrusted_until: Instant::ZERO, ..before }, role)
    };
    let unasked =
        || late(if before.pending > 0 || before.unanswered > 0 { Role::Late } else { Role::Duplicate });
    let closed = |(state, role)| (Correlator { open: None, ..state }, role);
    match outcome {
        Mal => (before, Role::Malformed),
        Lat => late(Role::Late),
        Rep => late(Role::LateReport),
        Una => unasked(),
        Reg if before.pending > 0 => late(Role::LateRegister),
        Reg if before.unanswered > 0 => late(Role::Late),
        Reg => (before, Role::Malformed),
        Giv => closed(unasked()),
        Amb => {
            closed((Correlator { pending: before.pending + 1, pending_since: at, ..before }, Role::Ambiguous))
        }
        Ans => {
            let Request { question, sent_at } = before.open.expect("it answers a request");
            closed((before, Role::Answer(question, at.since(sent_at))))
        }
    }
}

/// The value of `reports` after the payload.
fn expected_reports(outcome: Outcome, before: Correlator, shape: Shape) -> Reports {
    let answers_fault = before.open.is_some_and(|open| open.question == Fault);
    match (outcome, shape) {
        (Rep, _) => SEEN,
        (Ans | Giv, Report) if answers_fault => SEEN,
        _ => before.reports,
    }
}

/// Goal: every payload in every state at every time has the role that the table says, and leaves
/// the state it says. Method: all states that differ in any column, each looked up in the table;
/// exactly one row speaks of each.
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
fn new_request_leaves_the_open_one_pending() {
    let open = asked(Correlator::new(FASTEST), State, SENT);
    assert_eq!((open.pending, open.is_open()), (0, true));
    let in_time = asked(open, State, SENT + LATEST_REPLY);
    assert_eq!((in_time.pending, in_time.pending_since), (1, SENT + LATEST_REPLY));
    let nanosecond = Duration::from_nanos(1);
    assert_eq!(asked(open, State, SENT + LATEST_REPLY + nanosecond).pending, 0);
    let idle = in_time.withdraw();
    assert_eq!(asked(idle, State, in_time.pending_since + LATEST_REPLY).pending, 1);
    assert_eq!(asked(idle, State, in_time.pending_since + LATEST_REPLY + nanosecond).pending, 0);
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
fn report_without_shape_is_ambiguous_after_ten() {
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
    assert_eq!(role(DOUBTED_AFTER + 1), Role::Ambiguous);
}

/// Goal: no more replies are called late than requests were unanswered, however late, and a second
/// motor with the same id is still found. Method: `missed` silent turns of `period`; then two
/// replies to each request.
#[test]
fn surplus_replies_are_late_while_requests_are_unanswered() {
    for period in [1, 20, 100].map(Duration::from_millis) {
        for missed in [0, 1, 12, UNANSWERED_MAX, 10 * UNANSWERED_MAX] {
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
            let surplus: Vec<_> = (0..2 * UNANSWERED_MAX).map(|_| state.receive(Plain, at)).collect();
            let late = missed.min(UNANSWERED_MAX) as usize;
            assert!(surplus[..late].iter().all(|role| *role == Role::Late), "{period:?}, {missed}");
            assert!(surplus[late..].iter().all(|role| *role == Role::Duplicate), "{period:?}, {missed}");
        }
    }
}

#[test]
fn unsent_request_leaves_nothing_open() {
    let before = Correlator::new(FASTEST);
    assert_eq!(asked(before, Fault, SENT).withdraw(), before);
}

#[test]
fn unprompted_frame_changes_no_request() {
    for open in [None, Some(State), Some(Fault), Some(Clear), Some(Question::Register)] {
        let nothing = Correlator::new(FASTEST);
        let state = open.map_or(nothing, |question| asked(nothing, question, SENT));
        let after = received(state, Shape::Unprompted, SENT + Duration::from_millis(1));
        assert_eq!(after, (state, Role::Unprompted), "{open:?}");
    }
}
