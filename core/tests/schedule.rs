//! The rounds of safe frames of one bus.

use motord_bus::{Duration, Instant};
use motord_core::stopper::schedule::{SafeFrame, Schedule};

/// Time between two attempts on a bus that refuses for longer than the damping.
const RETRY: Duration = Duration::from_millis(100);
const DAMP: Duration = Duration::from_millis(100);
const BEGIN: Instant = Instant::from_nanos(1_000_000_000);

/// Returns the rounds of the bus, in ms since the begin, when it accepts those for which `accepts`
/// is true.
fn given(millis: u64, accepts: impl Fn(u64) -> bool) -> Vec<(u64, SafeFrame)> {
    let mut schedule = Schedule::begin(DAMP, BEGIN);
    let mut given = Vec::new();
    for at in 0..millis {
        let now = BEGIN + Duration::from_millis(at);
        let Some(order) = schedule.order(now) else { continue };
        given.push((at, order));
        schedule.record(accepts(at), now);
    }
    given
}

/// Returns damping at 100 Hz from `begin` on, then the stops.
fn whole_from(begin: u64) -> Vec<(u64, SafeFrame)> {
    let at = |round: u64| begin + 10 * round;
    (0..10)
        .map(|round| (at(round), SafeFrame::Damp))
        .chain((10..13).map(|round| (at(round), SafeFrame::Stop)))
        .collect()
}

#[test]
fn writable_bus_is_damped_then_stopped_then_idle() {
    assert_eq!(given(1000, |_| true), whole_from(0));
}

#[test]
fn late_bus_receives_full_sequence_at_full_rate() {
    let given = given(5000, |at| at >= 3000);
    let (refused, taken) = given.split_at(given.len() - 13);
    assert_eq!(taken, whole_from(3000));
    assert!(refused.iter().all(|(_, order)| *order == SafeFrame::Damp), "{refused:?}");
    assert_eq!(refused.len(), 10 + 29, "100 Hz for as long as the damping, then 10 Hz");
}

#[test]
fn jammed_bus_gets_the_remaining_rounds() {
    let was_taken = |at| !(20..3000).contains(&at);
    let given = given(5000, was_taken);
    let (late, first): (Vec<_>, Vec<_>) =
        given.into_iter().filter(|(at, _)| was_taken(*at)).partition(|(at, _)| *at >= 3000);
    assert_eq!(first, [(0, SafeFrame::Damp), (10, SafeFrame::Damp)]);
    let late: Vec<_> = late.into_iter().map(|(_, order)| order).collect();
    assert_eq!(late, [[SafeFrame::Damp; 8].as_slice(), &[SafeFrame::Stop; 3]].concat());
}

#[test]
fn bus_lost_while_stopping_gets_stops_later() {
    let given = given(5000, |at| at <= 100 || at >= 3000);
    let later: Vec<_> = given.iter().filter(|(at, _)| *at >= 3000).map(|(_, order)| *order).collect();
    assert_eq!(later, [SafeFrame::Stop; 2]);
}

#[test]
fn bus_that_never_accepts_is_retried_forever() {
    let given = given(100_000, |_| false);
    assert_eq!(given.last(), Some(&(99_900, SafeFrame::Damp)));
}

#[test]
fn a_schedule_that_was_stalled_sends_no_burst() {
    let mut schedule = Schedule::begin(DAMP, BEGIN);
    schedule.record(true, BEGIN);
    let late = BEGIN + Duration::from_millis(35);
    assert_eq!(schedule.order(late), Some(SafeFrame::Damp));
    schedule.record(true, late);
    assert_eq!(schedule.due(), Some(BEGIN + Duration::from_millis(40)), "the rounds keep their ticks");
}

#[test]
fn without_a_damping_time_there_are_only_stops() {
    let mut schedule = Schedule::begin(Duration::ZERO, BEGIN);
    assert_eq!(schedule.order(BEGIN), Some(SafeFrame::Stop));
    schedule.record(false, BEGIN);
    assert_eq!(schedule.order(BEGIN + RETRY), Some(SafeFrame::Stop));
}
