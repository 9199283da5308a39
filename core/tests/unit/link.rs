//! The buffers between the cycle and the other threads, with real threads. Miri runs it with many orders of the threads and with
//! loads that see old values (docs/adr/0028-concurrency-is-checked-by-miri.md).

use super::*;
use core::hint::spin_loop;
use motord_shared::{JointSetpoint, Operation};
use std::thread::scope;

/// Cycles of one run. Miri interprets each.
const CYCLES: u64 = if cfg!(miri) { 12 } else { 20_000 };
const STOPS: u32 = if cfg!(miri) { 3 } else { 500 };

/// A message whose every joint holds `number`: torn, it would hold two.
fn setpoint(number: u64) -> SetpointMessage {
    let joint = JointSetpoint { position: number as f32, ..JointSetpoint::default() };
    SetpointMessage {
        sequence: number,
        joint_count: 4,
        joints: [joint; JOINTS_MAX],
        ..SetpointMessage::default()
    }
}

fn is_whole(message: &SetpointMessage) -> bool {
    message.joints.iter().all(|joint| joint.position == message.sequence as f32)
}

fn record() -> Record {
    let (at, state) = (Instant::ZERO, StateMessage::default());
    let wake = Wake { cycle: 1, scheduled: at, begun: at, ..Wake::default() };
    Record::of(&wake, at, at, None, Polled::default(), &state)
}

/// The threads that have not ended yet: those that want something of the cycle, and the cycle.
struct Alive {
    others: AtomicU32,
    cycle: AtomicU32,
}

/// Counts its thread out, also when that panics: else the others would wait for it for ever.
struct Leaves<'a>(&'a AtomicU32);

impl Drop for Leaves<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Release);
    }
}

fn are_gone(threads: &AtomicU32) -> bool {
    threads.load(Ordering::Acquire) == 0
}

/// The cycle: takes all that is there, and publishes a state that holds its number in every joint, until nobody wants more.
fn run(link: &mut Link, alive: &Alive) -> (u32, u32) {
    let _leaves = Leaves(&alive.cycle);
    let (mut stops, mut alarms, mut newest) = (0, 0, 0);
    let (mut cycle, mut is_last) = (0, false);
    while !is_last {
        is_last = cycle >= CYCLES && are_gone(&alive.others);
        cycle += 1;
        link.beat(cycle);
        stops += u32::from(link.next_stop().is_some());
        alarms += u32::from(link.take_stops()[0].is_some()) + link.take_ended().count() as u32;
        while let Some((ticket, request)) = link.next_request() {
            link.answer(ticket, AdminReply { lease: request.lease, ..AdminReply::default() });
        }
        link.newest_setpoints(|message| {
            assert!(is_whole(message) && message.sequence > newest, "whole, and newer than the one before");
            newest = message.sequence;
        });
        let (state, _) = link.state();
        state.cycle = cycle;
        state.joints.iter_mut().for_each(|joint| joint.missed = cycle as u32);
        link.publish(record());
    }
    (stops, alarms)
}

/// The ipc thread: setpoints and requests in, states and answers out. As many requests as may be are under way.
fn ipc(ends: &mut Ends, alive: &Alive) {
    let _leaves = Leaves(&alive.others);
    let (mut newest, mut sent, mut asked, mut answered) = (0, 0, 0, 0);
    while newest < CYCLES / 2 || answered < asked {
        assert!(!are_gone(&alive.cycle));
        if newest < CYCLES / 2 {
            sent += 1;
            ends.setpoints[0].write(setpoint(sent));
        }
        if newest < CYCLES / 2 && asked - answered < REQUESTS_MAX as u32 {
            asked += 1;
            let request = AdminRequest {
                lease: asked.into(),
                operation: Operation::Claim.code(),
                ..Default::default()
            };
            ends.requests.push((asked, request)).expect("no more under way than have room");
        }
        let state = ends.states.read();
        assert!(state.joints.iter().all(|joint| joint.missed == state.cycle as u32), "a whole state");
        assert!(state.cycle >= newest, "states do not go back");
        newest = state.cycle;
        while let Ok((ticket, reply)) = ends.answers.pop() {
            answered += 1;
            assert_eq!((ticket, reply.lease), (answered, answered.into()), "each once, and in order");
        }
        while ends.records.pop().is_ok() {}
        spin_loop();
    }
}

#[test]
fn every_state_reaches_a_recorder_in_order_or_is_counted_and_none_while_nobody_records() {
    let (mut link, Ends { mut history, counters, .. }) = link(1);
    let publish = |link: &mut Link, cycle| {
        link.state().0.cycle = cycle;
        link.state().0.joint_count = 4;
        link.state().0.joints[..4].iter_mut().for_each(|joint| joint.missed = cycle as u32);
        link.publish(record());
    };
    publish(&mut link, 0);
    history.take_all(|_| panic!("nobody records"));
    history.want(true);
    let done = AtomicBool::new(false);
    let taken = scope(|threads| {
        let reader = threads.spawn(|| {
            let (mut taken, mut before, mut has_ended) = (0, 0, false);
            while !has_ended {
                has_ended = done.load(Ordering::Acquire);
                history.take_all(|state| {
                    assert!(state.cycle > before, "in order, each once");
                    assert!(state.joints().iter().all(|joint| u64::from(joint.missed) == state.cycle));
                    (taken, before) = (taken + 1, state.cycle);
                });
                spin_loop();
            }
            taken
        });
        (1..=CYCLES).for_each(|cycle| publish(&mut link, cycle));
        done.store(true, Ordering::Release);
        reader.join().unwrap()
    });
    // The records for telemetry, which nobody takes here, are counted by the same counter once their ring is full.
    let records_dropped = (CYCLES + 1).saturating_sub(RECORDS as u64);
    assert_eq!(taken + counters.dropped.load(Ordering::Relaxed), CYCLES + records_dropped);
}

#[test]
fn no_thread_sees_half_a_message_and_every_stop_is_taken_once() {
    let (mut link, mut ends) = link(1);
    let (stops, counters) = (Arc::clone(&ends.stops), Arc::clone(&ends.counters));
    let alive = Alive { others: AtomicU32::new(3), cycle: AtomicU32::new(1) };
    let taken = scope(|threads| {
        let cycle = threads.spawn(|| run(&mut link, &alive));
        threads.spawn(|| {
            let _leaves = Leaves(&alive.others);
            for pid in 1..=STOPS {
                let request = stops.ask(pid);
                while !stops.is_done(request) {
                    assert!(!are_gone(&alive.cycle));
                    spin_loop();
                }
            }
        });
        threads.spawn(|| {
            let _leaves = Leaves(&alive.others);
            counters.alarms.owner_ended(Lease::new(7, 1, 0).unwrap());
            counters.alarms.stop(Cause::DirectoryLost);
        });
        ipc(&mut ends, &alive);
        cycle.join().unwrap()
    });
    assert_eq!(taken, (STOPS, 2), "stops and alarms, each once");
}
