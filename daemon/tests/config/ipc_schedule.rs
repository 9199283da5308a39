//! The wake-ups of the ipc thread: decisions on given times, without a thread.

use motord::ipc::{Schedule, Wake};
use motord_bus::{Duration, Instant};
use motord_shared::{GroupState, Lease, Phase, StateMessage};

const fn micros(micros: u64) -> Instant {
    Instant::from_nanos(1000 * micros)
}

/// After many cycles that published 700 µs after their tick, the last of them at 5000 µs.
fn schedule(busy_poll: u64, phase: Phase, lease: Option<Lease>) -> Schedule {
    let [lead, busy_poll] = [50, busy_poll].map(Duration::from_micros);
    let mut schedule = Schedule::new(Duration::from_millis(1), lead, busy_poll);
    let mut state =
        StateMessage { tick_ns: 5_000_000, publish_ns: 5_700_000, group_count: 2, ..Default::default() };
    let group = GroupState { phase: Phase::Disarmed.code(), ..Default::default() };
    state.groups[..2].fill(group);
    state.groups[1].phase = phase.code();
    state.groups[1].lease = lease.map_or(0, Lease::raw);
    (0..200).for_each(|_| schedule.observe(&state));
    schedule
}

#[test]
fn thread_wakes_before_cycle_only_if_needed() {
    let lease = Lease::new(1, 1, 0);
    for (phase, lease) in [(Phase::Disarmed, lease), (Phase::Damping, None), (Phase::Active, lease)] {
        let mut schedule = schedule(0, phase, lease);
        let mut next = |now| schedule.next(micros(now)).at;
        assert_eq!(next(5700), micros(5950), "in time for the next cycle");
        assert_eq!(next(5949), micros(5950), "however close that is");
        assert_eq!(next(5950), micros(6950), "not twice before one cycle");
        assert_eq!(next(5970), micros(6950), "on the grid after a late one");
        assert_eq!(next(9000), micros(10_000), "the cycle stands still");
    }
    let mut calm = schedule(30, Phase::Disarmed, None);
    assert_eq!(calm.next(micros(5700)).at, micros(7000), "the states of the next cycle end it");
}

#[test]
fn late_wakeup_is_requested_sooner_fetch_not() {
    let mut schedule = schedule(0, Phase::Active, Lease::new(1, 1, 0));
    for _ in 0..1000 {
        let wake = schedule.next(micros(5700));
        schedule.woken(wake, wake.sleeps_until + Duration::from_micros(20));
    }
    let Wake { sleeps_until, at, is_for_states } = schedule.next(micros(5700));
    assert!((micros(5930)..micros(5932)).contains(&sleeps_until), "{sleeps_until:?}");
    assert_eq!((at, is_for_states), (micros(5950), false));
}

#[test]
fn setpoints_are_fetched_when_they_usually_arrive() {
    let mut schedule = schedule(0, Phase::Active, Lease::new(1, 1, 0));
    (0..640).for_each(|_| schedule.arrived(micros(5800)));
    let earlier = schedule.next(micros(5700)).at;
    assert!((micros(5810)..micros(5820)).contains(&earlier), "{earlier:?}");
    assert_eq!(schedule.next(earlier).at, micros(5950), "the last fetch remains");
    for sent in [5930, 4000, 9000, u64::MAX / 1000] {
        schedule.arrived(micros(sent));
        assert!(schedule.next(micros(5700)).at <= micros(5950), "whatever a sender states");
    }
    schedule.arrived(micros(5930));
    assert_eq!(schedule.next(micros(5700)).at, micros(5950), "one that is almost the last is none");
}

#[test]
fn answered_states_need_no_further_fetch() {
    let mut schedule = schedule(30, Phase::Active, Lease::new(1, 1, 0));
    schedule.answered();
    let states = schedule.next(micros(5800));
    assert!(states.is_for_states && (micros(6730)..micros(6735)).contains(&states.at), "{states:?}");
    assert_eq!(schedule.next(states.at).at, micros(6950), "if they do not come");
    let state = StateMessage { tick_ns: 6_000_000, publish_ns: 6_700_000, ..Default::default() };
    let owned = GroupState { lease: 1, ..Default::default() };
    let mut state = StateMessage { group_count: 1, ..state };
    state.groups[0] = owned;
    schedule.observe(&state);
    assert_eq!(schedule.next(micros(6700)).at, micros(6950), "new states need new answers");
}

#[test]
fn states_are_polled_when_they_usually_arrive() {
    let mut schedule = schedule(30, Phase::Active, Lease::new(1, 1, 0));
    assert_eq!(schedule.next(micros(5700)).at, micros(5950), "first the fetch");
    let states = schedule.next(micros(5950));
    assert!(states.is_for_states && (micros(6730)..micros(6735)).contains(&states.at), "{states:?}");
    assert_eq!(schedule.next(states.at).at, micros(6950), "once in a cycle");
    let polls = (0..640).filter(|_| {
        let wake = schedule.next(micros(5950));
        schedule.waited(wake, false);
        wake.is_for_states
    });
    assert!(polls.count() < 20);
}
