//! Connects the real-time thread with the others: wait-free buffers and preallocated rings. Nothing
//! blocks.
//!
//! | what | from | to | when full |
//! |---|---|---|---|
//! | setpoints, by group | ipc | cycle | the newest replaces the one before |
//! | samples, by IMU | its reader | cycle | the newest replaces the one before |
//! | states | cycle | ipc | the newest replaces the one before |
//! | emergency stops | the thread of their socket | cycle | the newest replaces the one before |
//! | requests | ipc | cycle | refused: busy |
//! | answers | cycle | ipc | as many as requests under way, so never |
//! | alarms | telemetry, owners | cycle | the newest replaces the one before |
//! | opened buses, old buses | reconnector, cycle | cycle, reconnector | as many as buses, so never |
//! | records, events | cycle | telemetry | dropped and counted |
//! | all states, while a recorder is connected | cycle | ipc | dropped and counted |
//! | their queue, new and old | telemetry, cycle | cycle, telemetry | one at a time, so never |

use super::emergency::{AskedStops, EmergencyStops};
use super::history::{Histories, Queues, histories};
use super::replacement::{Indexed, Replacements, Supply, replacements};
use crate::control::{Event, ImuReading, Reading, Wake};
use motord_bus::time::nanos;
use motord_bus::{Bus, Duration, Instant};
use motord_shared::limits::{BUSES_MAX, GROUPS_MAX, IMUS_MAX, JOINTS_MAX};
use motord_shared::{AdminReply, AdminRequest, Cause, Lease, SetpointMessage, StateMessage, message};
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use triple_buffer::TripleBuffer;

/// Most open requests: those whose answers the other threads have not taken yet.
pub const REQUESTS_MAX: usize = 256;
/// A second of a 1 kHz cycle.
const RECORDS: usize = 1024;
const EVENTS: usize = 4096;

/// The measurements of one cycle, for telemetry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Record {
    /// Its number.
    pub cycle: u64,
    /// When it should have begun.
    pub scheduled: Instant,
    /// Lateness of its beginning, ns.
    pub wake_latency_ns: u64,
    /// From its beginning until all of its frames were handed over, ns.
    pub transmit_ns: u64,
    /// From its beginning to the publication of the states, ns.
    pub cycle_ns: u64,
    /// Age of the oldest setpoint that an active group used, ns; `None` without an active group.
    pub setpoint_age_ns: Option<u64>,
    /// By group, the cycle whose states its setpoint answers, where this cycle is the first to use
    /// it; else 0.
    pub answered_cycle: [u64; GROUPS_MAX],
    /// From the last state that arrived in this cycle to the publication, ns; `None` without one.
    pub publication_ns: Option<u64>,
    /// Its polling for the last replies.
    pub polled: Polled,
    /// Turns without a reply, over all motors, since the start.
    pub missed: u64,
    /// Ticks missed just before this cycle.
    pub missed_ticks: u64,
    /// Time from command to reply, ns, by joint; 0 without a reply in this cycle.
    pub reply_latency_ns: [u32; JOINTS_MAX],
    /// Time from the receipt of its newest sample to the publication, ns, by IMU; 0 for one that is
    /// lost.
    pub imu_age_ns: [u32; IMUS_MAX],
}

/// The polling for replies in a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Polled {
    /// From its first read to the end of its last; zero when there was none.
    pub time: Duration,
    /// Reads of a bus, each a system call.
    pub reads: u32,
    /// Some replies had not arrived by its end.
    pub is_incomplete: bool,
}

impl Record {
    /// Of the cycle that began with `wake`, whose `state` is published. Bounded by joints, groups
    /// and IMUs.
    pub(super) fn of(
        wake: &Wake,
        transmitted: Instant,
        published: Instant,
        setpoint_age: Option<Duration>,
        polled: Polled,
        state: &StateMessage,
    ) -> Self {
        let (mut reply_latency_ns, mut missed, mut last_reply) = ([0; JOINTS_MAX], 0, 0);
        for (joint, latency) in state.joints().iter().zip(&mut reply_latency_ns) {
            missed += u64::from(joint.missed);
            if joint.flags & message::JOINT_FRESH != 0 {
                *latency = joint.reply_latency_ns;
                last_reply = joint.receive_ns.max(last_reply);
            }
        }
        let mut answered_cycle = [0; GROUPS_MAX];
        for (group, answered) in state.groups().iter().zip(&mut answered_cycle) {
            *answered = if group.used_cycle == wake.cycle { group.answered_cycle } else { 0 };
        }
        let mut imu_age_ns = [0; IMUS_MAX];
        for (imu, age) in state.imus().iter().zip(&mut imu_age_ns) {
            let is_known = imu.flags & message::IMU_LOST == 0;
            let past_ns = published.as_nanos().saturating_sub(imu.receive_ns);
            *age = if is_known { u32::try_from(past_ns).unwrap_or(u32::MAX) } else { 0 };
        }
        Self {
            cycle: wake.cycle,
            scheduled: wake.scheduled,
            wake_latency_ns: nanos(wake.begun.since(wake.scheduled)),
            transmit_ns: nanos(transmitted.since(wake.begun)),
            cycle_ns: nanos(published.since(wake.begun)),
            setpoint_age_ns: setpoint_age.map(nanos),
            answered_cycle,
            polled,
            publication_ns: (last_reply > wake.begun.as_nanos())
                .then(|| published.as_nanos().saturating_sub(last_reply)),
            missed,
            missed_ticks: wake.missed_ticks,
            reply_latency_ns,
            imu_age_ns,
        }
    }
}

/// The real-time thread's end.
pub struct RealTimeEnd {
    setpoints: Vec<triple_buffer::Output<SetpointMessage>>,
    imus: Vec<triple_buffer::Output<ImuReading>>,
    states: triple_buffer::Input<StateMessage>,
    requests: Consumer<(u32, AdminRequest)>,
    answers: Producer<(u32, AdminReply)>,
    records: Producer<Record>,
    events: Producer<(u64, Event)>,
    counters: Arc<Counters>,
    published: Option<Box<dyn Fn() + Send>>,
    begun: Option<Box<dyn Fn(u64) + Send>>,
    replacements: Replacements,
    stops: AskedStops,
    queues: Queues,
}

/// The other threads' end.
pub struct Ends {
    /// One buffer per group.
    pub setpoints: Vec<triple_buffer::Input<SetpointMessage>>,
    /// One buffer per IMU.
    pub imus: Vec<triple_buffer::Input<ImuReading>>,
    /// The newest state.
    pub states: triple_buffer::Output<StateMessage>,
    /// Requests, with the ticket that their answer will bear.
    pub requests: Producer<(u32, AdminRequest)>,
    /// Answers.
    pub answers: Consumer<(u32, AdminReply)>,
    /// One per cycle.
    pub records: Consumer<Record>,
    /// With the number of their cycle.
    pub events: Consumer<(u64, Event)>,
    /// Counters.
    pub counters: Arc<Counters>,
    /// Takes reopened buses. Without it, a disconnected bus stays disconnected.
    pub supply: Supply,
    /// Emergency stops, which wait in no queue.
    pub stops: Arc<EmergencyStops>,
    /// Queues of every state, for recorders.
    pub histories: Histories,
}

/// Counters that both sides may read at any time.
#[derive(Debug, Default)]
pub struct Counters {
    /// The number of the running cycle. It advances while the cycle runs.
    pub cycle: AtomicU64,
    /// Records and events that telemetry did not take in time, and states for recorders that the
    /// ipc thread did not take in time.
    pub dropped: AtomicU64,
    /// Frames that the kernel kept from the cycle because no motor of the bus has their id, by bus,
    /// modulo 2³².
    pub unexpected_ids: [AtomicU32; BUSES_MAX],
    /// Setpoint messages that do not bear the lease of their group's owner, by group, modulo 2³².
    pub wrong_lease: [AtomicU32; GROUPS_MAX],
    /// Calls to the services that failed.
    pub ipc_errors: AtomicU64,
    /// Time that the plant of a simulated robot lost, µs.
    pub plant_lost_us: AtomicU64,
    /// Samples for no external IMU of this daemon.
    pub foreign_imu_samples: AtomicU64,
    /// The configuration file has changed since the start.
    pub config_changed: AtomicBool,
    /// Alarms that the cycle has not handled yet.
    pub alarms: Alarms,
}

/// Alarms of other threads, which the next cycle handles.
#[derive(Debug, Default)]
pub struct Alarms {
    /// The code of a cause; 0 is none.
    stop: AtomicU32,
    /// The code of a cause that persists; 0 is none.
    standing: AtomicU32,
    /// By group, the lease of an owner whose process exited; 0 is none.
    ended: [AtomicU64; GROUPS_MAX],
}

impl Alarms {
    /// Stops every group for `cause`. Wait-free.
    pub fn stop(&self, cause: Cause) {
        self.stop.store(cause.code(), Ordering::Release);
    }

    /// Stops every group for `cause` in every cycle until it is `None` again, so that no group
    /// becomes active. Wait-free.
    pub fn stand(&self, cause: Option<Cause>) {
        self.standing.store(cause.map_or(0, Cause::code), Ordering::Release);
    }

    /// Reports that the process that holds `lease` exited. Wait-free.
    pub fn owner_ended(&self, lease: Lease) {
        if let Some(ended) = self.ended.get(lease.group()) {
            ended.store(lease.raw(), Ordering::Release);
        }
    }
}

/// Creates both ends. Allocates; nothing after it does.
#[must_use]
pub fn link(groups: usize, imus: usize) -> (RealTimeEnd, Ends) {
    let groups = groups.min(GROUPS_MAX);
    let (imu_inputs, imu_outputs) =
        (0..imus.min(IMUS_MAX)).map(|_| TripleBuffer::new(&ImuReading::default()).split()).unzip();
    let (setpoint_inputs, setpoint_outputs) =
        (0..groups).map(|_| TripleBuffer::new(&SetpointMessage::default()).split()).unzip();
    let (state_input, state_output) = TripleBuffer::new(&StateMessage::default()).split();
    let (request_producer, request_consumer) = RingBuffer::new(REQUESTS_MAX);
    let (answer_producer, answer_consumer) = RingBuffer::new(REQUESTS_MAX);
    let (record_producer, record_consumer) = RingBuffer::new(RECORDS);
    let (event_producer, event_consumer) = RingBuffer::new(EVENTS);
    let (replacements, supply) = replacements();
    let (queues, histories) = histories();
    let counters = Arc::new(Counters::default());
    let stops = Arc::new(EmergencyStops::default());
    let link = RealTimeEnd {
        setpoints: setpoint_outputs,
        imus: imu_outputs,
        states: state_input,
        requests: request_consumer,
        answers: answer_producer,
        records: record_producer,
        events: event_producer,
        counters: Arc::clone(&counters),
        published: None,
        begun: None,
        replacements,
        stops: AskedStops::new(Arc::clone(&stops)),
        queues,
    };
    let ends = Ends {
        setpoints: setpoint_inputs,
        imus: imu_inputs,
        states: state_output,
        requests: request_producer,
        answers: answer_consumer,
        records: record_consumer,
        events: event_consumer,
        counters,
        supply,
        stops,
        histories,
    };
    (link, ends)
}

impl RealTimeEnd {
    pub(super) fn on_publish(&mut self, published: impl Fn() + Send + 'static) {
        self.published = Some(Box::new(published));
    }

    pub(super) fn next_bus(&mut self) -> Option<Indexed> {
        self.replacements.take()
    }

    pub(super) fn retire_bus(&mut self, bus: Box<dyn Bus>) {
        self.replacements.retire(bus);
    }

    pub(super) fn on_begin(&mut self, begun: impl Fn(u64) + Send + 'static) {
        self.begun = Some(Box::new(begun));
    }

    pub(super) fn beat(&self, cycle: u64) {
        self.counters.cycle.store(cycle, Ordering::Release);
        if let Some(begun) = &self.begun {
            begun(cycle);
        }
    }

    pub(super) fn next_request(&mut self) -> Option<(u32, AdminRequest)> {
        self.requests.pop().ok()
    }

    /// Takes the process id of the requester of an emergency stop.
    pub(super) fn next_stop(&mut self) -> Option<u32> {
        self.stops.take()
    }

    pub(super) fn answer(&mut self, ticket: u32, reply: AdminReply) {
        // The ipc thread limits the number of open requests to the size of the ring.
        let _never_full = self.answers.push((ticket, reply));
    }

    pub(super) fn newest_setpoints(&mut self, mut offer: impl FnMut(&SetpointMessage)) {
        for setpoint in &mut self.setpoints {
            if setpoint.update() {
                offer(setpoint.output_buffer());
            }
        }
    }

    /// Passes the readings of other threads that are new. Wait-free; bounded by sensors.
    pub(super) fn newest_readings(&mut self, mut take: impl FnMut(Reading<'_>)) {
        for (index, imu) in self.imus.iter_mut().enumerate() {
            if imu.update() {
                take(Reading::Imu(index, imu.output_buffer()));
            }
        }
    }

    /// Takes the causes to stop every group: one of them once, the other while it persists.
    /// Wait-free.
    pub(super) fn take_stops(&self) -> [Option<Cause>; 2] {
        let Alarms { stop, standing, .. } = &self.counters.alarms;
        let once = if stop.load(Ordering::Relaxed) == 0 { 0 } else { stop.swap(0, Ordering::Acquire) };
        [once, standing.load(Ordering::Acquire)].map(|code| Cause::try_from(code).ok())
    }

    /// Takes the leases of owners whose processes exited. Wait-free; bounded by groups.
    pub(super) fn take_ended(&self) -> impl Iterator<Item = Lease> {
        let ended = self.counters.alarms.ended.iter().filter(|ended| ended.load(Ordering::Relaxed) != 0);
        ended.filter_map(|ended| Lease::from_raw(ended.swap(0, Ordering::Acquire)))
    }

    /// Returns the message for the states of this cycle, and the counters of the other threads.
    pub(super) fn state(&mut self) -> (&mut StateMessage, &Counters) {
        (self.states.input_buffer_mut(), &self.counters)
    }

    /// Publishes the message, and wakes the ipc thread.
    pub(super) fn publish(&mut self, record: Record) {
        let kept = self.queues.put(self.states.input_buffer_mut());
        self.states.publish();
        self.stops.confirm();
        let dropped = self.records.push(record).is_err();
        self.lose(u32::from(dropped) + u32::from(!kept));
        if let Some(published) = &self.published {
            published();
        }
    }

    pub(super) fn push(&mut self, cycle: u64, event: Event) {
        let dropped = self.events.push((cycle, event)).is_err();
        self.lose(u32::from(dropped));
    }

    pub(super) fn lose(&self, dropped: u32) {
        if dropped > 0 {
            self.counters.dropped.fetch_add(u64::from(dropped), Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    // Miri runs these tests with many orders of the threads and with loads that see old values
    // (docs/adr/0028-concurrency-is-checked-by-miri.md).

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

    fn have_exited(threads: &AtomicU32) -> bool {
        threads.load(Ordering::Acquire) == 0
    }

    /// The cycle: takes all requests, and publishes a state with its number in every joint, until
    /// the other threads end.
    fn run(link: &mut RealTimeEnd, alive: &Alive) -> (u32, u32) {
        let _leaves = Leaves(&alive.cycle);
        let (mut stops, mut alarms, mut newest) = (0, 0, 0);
        let (mut cycle, mut is_last) = (0, false);
        while !is_last {
            is_last = cycle >= CYCLES && have_exited(&alive.others);
            cycle += 1;
            link.beat(cycle);
            stops += u32::from(link.next_stop().is_some());
            alarms += u32::from(link.take_stops()[0].is_some()) + link.take_ended().count() as u32;
            while let Some((ticket, request)) = link.next_request() {
                link.answer(ticket, AdminReply { lease: request.lease, ..AdminReply::default() });
            }
            link.newest_setpoints(|message| {
                assert!(
                    is_whole(message) && message.sequence > newest,
                    "whole, and newer than the one before"
                );
                newest = message.sequence;
            });
            let (state, _) = link.state();
            state.cycle = cycle;
            state.joints.iter_mut().for_each(|joint| joint.missed = cycle as u32);
            link.publish(record());
        }
        (stops, alarms)
    }

    /// The ipc thread: setpoints and requests in, states and answers out. As many requests as may
    /// be are under way.
    fn ipc(ends: &mut Ends, alive: &Alive) {
        let _leaves = Leaves(&alive.others);
        let (mut newest, mut sent, mut asked, mut answered) = (0, 0, 0, 0);
        while newest < CYCLES / 2 || answered < asked {
            assert!(!have_exited(&alive.cycle));
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
    fn recorder_receives_states_in_order_or_counts_them() {
        let (mut link, Ends { mut histories, counters, .. }) = link(1, 0);
        let publish = |link: &mut RealTimeEnd, cycle| {
            link.state().0.cycle = cycle;
            link.state().0.joint_count = 4;
            link.state().0.joints[..4].iter_mut().for_each(|joint| joint.missed = cycle as u32);
            link.publish(record());
        };
        publish(&mut link, 0);
        let mut history = histories.begin().unwrap();
        history.take_all(|_| panic!("nobody recorded"));
        let done = AtomicBool::new(false);
        let (taken, history) = scope(|threads| {
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
                (taken, history)
            });
            (1..=CYCLES).for_each(|cycle| publish(&mut link, cycle));
            done.store(true, Ordering::Release);
            reader.join().unwrap()
        });
        // The records for telemetry, which no thread takes here, are counted by the same counter
        // when their ring is full.
        let records_dropped = (CYCLES + 1).saturating_sub(RECORDS as u64);
        assert_eq!(taken + counters.dropped.load(Ordering::Relaxed), CYCLES + records_dropped);
        assert!(histories.begin().is_none(), "one at a time");
        drop(history);
        assert!(!histories.is_free(), "the cycle has a part of it");
        publish(&mut link, CYCLES + 1);
        assert!(histories.is_free());
    }

    #[test]
    fn messages_are_never_torn_and_stops_taken_once() {
        let (mut link, mut ends) = link(1, 0);
        let (stops, counters) = (Arc::clone(&ends.stops), Arc::clone(&ends.counters));
        let alive = Alive { others: AtomicU32::new(3), cycle: AtomicU32::new(1) };
        let taken = scope(|threads| {
            let cycle = threads.spawn(|| run(&mut link, &alive));
            threads.spawn(|| {
                let _leaves = Leaves(&alive.others);
                for pid in 1..=STOPS {
                    let request = stops.ask(pid);
                    while !stops.is_done(request) {
                        assert!(!have_exited(&alive.cycle));
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
}
