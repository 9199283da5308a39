//! The ipc thread: owns every iceoryx2 port, and stands between the clients and the cycle.
//!
//! Not real-time: iceoryx2 may allocate, and maps files when a client connects or disconnects. If
//! this thread stalls, setpoints expire and the cycle damps the robot.

pub mod owners;
mod pending;
mod records;
mod schedule;

use crate::imus::ExternalImus;
use crate::telemetry::Questions;
use motord_bus::{Instant, clock};
use motord_core::cycle::{Counters, Ends, REQUESTS_MAX, Supply};
use motord_ports::{DaemonPorts, ImuReceiver, Request};
use motord_settings::settings::IpcMode;
use motord_shared::limits::{ADMINS_MAX, GROUPS_MAX, REQUESTS_PER_CLIENT};
use motord_shared::message::NO_JOINT;
use motord_shared::{AdminReply, AdminRequest, Lease, Operation, Refusal, SetpointMessage, StateMessage};
use owners::Owners;
use pending::Pending;
pub use records::Records;
use rtrb::{Consumer, Producer};
pub use schedule::{Schedule, Wake};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::Sender;

/// Requests taken from clients each time the thread wakes.
const REQUESTS_PER_WAKE: usize = 64;
/// A thread that spins checks for requests once in this number of turns: each check delays the
/// states for the controllers.
const TURNS_PER_REQUEST: u32 = 8;
/// Request slots that are reserved for emergency stops.
const STOPS: usize = ADMINS_MAX;
/// Most requests that telemetry has yet to answer.
const QUESTIONS_MAX: usize = ADMINS_MAX * REQUESTS_PER_CLIENT;

/// The cycle's other end, as far as clients are concerned.
pub struct CycleEnd {
    setpoints: Vec<triple_buffer::Input<SetpointMessage>>,
    states: triple_buffer::Output<StateMessage>,
    requests: Producer<(u32, AdminRequest)>,
    answers: Consumer<(u32, AdminReply)>,
    counters: Arc<Counters>,
}

impl CycleEnd {
    /// Divides `ends` into the clients' part, the telemetry's part, and the part of the thread that
    /// opens buses again.
    #[must_use]
    pub fn split(ends: Ends) -> (Self, crate::telemetry::CycleEnd, Supply) {
        let Ends {
            setpoints,
            states,
            requests,
            answers,
            records,
            events,
            counters,
            supply,
            histories,
            stops: _,
            imus: _,
        } = ends;
        let telemetry =
            crate::telemetry::CycleEnd { records, events, histories, counters: Arc::clone(&counters) };
        (Self { setpoints, states, requests, answers, counters }, telemetry, supply)
    }
}

/// The ipc thread.
pub struct IpcThread {
    ports: DaemonPorts,
    cycle: CycleEnd,
    questions: Questions,
    description: String,
    mode: IpcMode,
    /// Requests that the cycle has not answered yet.
    requested: Pending<Request>,
    /// Requests that telemetry has not answered yet.
    questioned: Pending<Request>,
    leases: [Option<Lease>; GROUPS_MAX],
    /// By group, the cycle whose states the newest setpoint of its owner answers.
    answered: [u64; GROUPS_MAX],
    schedule: Schedule,
    /// `None` where owners are not watched: there only an owner's silence shows that it has ended.
    owners: Option<Owners>,
    records: Records,
    imus: Option<(ImuReceiver, ExternalImus)>,
    /// Receives one message after the first state.
    first_state: Option<Sender<()>>,
}

impl IpcThread {
    /// Takes the ends of the services, the cycle and telemetry. `description` is the answer to
    /// [`Operation::Describe`]. Without `owners`, no process of an owner is watched.
    #[must_use]
    pub fn new(
        ports: DaemonPorts,
        (cycle, owners): (CycleEnd, Option<Owners>),
        questions: Questions,
        description: String,
        mode: IpcMode,
        schedule: Schedule,
        records: Records,
    ) -> Self {
        Self {
            ports,
            cycle,
            questions,
            description,
            mode,
            requested: Pending::new(REQUESTS_MAX),
            questioned: Pending::new(QUESTIONS_MAX),
            leases: [None; GROUPS_MAX],
            answered: [0; GROUPS_MAX],
            schedule,
            owners,
            records,
            imus: None,
            first_state: None,
        }
    }

    /// Sends one message after the first state was published, or an error kept it from a client.
    #[must_use]
    pub fn announcing(self, first_state: Sender<()>) -> Self {
        Self { first_state: Some(first_state), ..self }
    }

    /// Takes the samples of external IMUs as well.
    #[must_use]
    pub fn with_imus(self, receiver: ImuReceiver, imus: ExternalImus) -> Self {
        Self { imus: Some((receiver, imus)), ..self }
    }

    /// Runs until `stop` returns true.
    pub fn run(&mut self, stop: impl Fn() -> bool) {
        let mut turns = 0_u32;
        while !stop() {
            turns = turns.wrapping_add(1);
            if self.mode != IpcMode::Spin || turns.is_multiple_of(TURNS_PER_REQUEST) {
                self.turn();
            } else {
                self.relay();
            }
            self.wait();
        }
        // The last states tell the clients that the daemon is leaving.
        self.turn();
    }

    fn turn(&mut self) {
        self.relay();
        self.record();
        self.take_requests();
        self.give_answers();
    }

    /// Does what is urgent: publishes the states for the waiting controllers, and fetches the
    /// setpoints for the next cycle. After new states it makes the message of the next ones ready.
    fn relay(&mut self) {
        let has_published = self.publish_states();
        self.fetch_setpoints();
        self.fetch_imu_samples();
        if has_published {
            self.ports.prepare();
        }
    }

    /// Sleeps until the cycle has published its states, or [`Schedule::next`] says so.
    fn wait(&mut self) {
        if self.mode == IpcMode::Spin {
            std::hint::spin_loop();
            return;
        }
        let now = clock::monotonic();
        let next = self.schedule.next(now);
        if next.sleeps_until > now {
            std::thread::park_timeout(next.sleeps_until.since(now));
            let woken = clock::monotonic();
            if woken < next.sleeps_until {
                return;
            }
            self.schedule.woken(next, woken);
        }
        let Self { cycle, schedule, .. } = self;
        while !cycle.states.updated() && clock::monotonic() < next.at {
            std::hint::spin_loop();
        }
        schedule.waited(next, cycle.states.updated());
    }

    fn fetch_setpoints(&mut self) {
        let Self { ports, cycle, leases, answered, records, schedule, .. } = self;
        let taken = ports.take_setpoint(|message| {
            let Some(lease) = Lease::from_raw(message.lease) else { return };
            let Some(buffer) = cycle.setpoints.get_mut(lease.group()) else { return };
            // Another's message would push the owner's out of the buffer, so it is counted here and
            // goes no further.
            if leases[lease.group()] == Some(lease) {
                buffer.input_buffer_mut().copy_from(message);
                buffer.publish();
                records.note(message);
                answered[lease.group()] = message.cycle;
                schedule.arrived(Instant::from_nanos(message.time_ns));
            } else {
                cycle.counters.wrong_lease[lease.group()].fetch_add(1, Ordering::Relaxed);
            }
        });
        self.count(taken.is_err());
        if self.is_answered() {
            self.schedule.answered();
        }
    }

    /// Every owner has answered the newest states. A cycle needs the newest sample of an external
    /// IMU, whose time has nothing to do with the states.
    fn is_answered(&mut self) -> bool {
        let newest = self.cycle.states.output_buffer().cycle;
        let mut owned = self.leases.iter().zip(&self.answered).filter(|(lease, _)| lease.is_some());
        self.imus.is_none() && owned.all(|(_, answered)| *answered == newest)
    }

    fn fetch_imu_samples(&mut self) {
        let Some((receiver, imus)) = &mut self.imus else { return };
        let mut foreign = 0;
        // A sample that arrives while others are taken must not seem to be of the future.
        let taken = receiver.take(|message| {
            foreign += u64::from(!imus.receive(message, clock::monotonic()));
        });
        if foreign > 0 {
            self.cycle.counters.foreign_imu_samples.fetch_add(foreign, Ordering::Relaxed);
        }
        self.count(taken.is_err());
    }

    /// Returns whether there were new ones.
    fn publish_states(&mut self) -> bool {
        if !self.cycle.states.update() {
            return false;
        }
        let state = self.cycle.states.output_buffer();
        // A damaged connection must not keep other clients asleep.
        let published = self.ports.publish(state).and(self.ports.notify());
        if published.is_ok() && !self.questions.delivered(state, clock::monotonic()) {
            self.cycle.counters.dropped.fetch_add(1, Ordering::Relaxed);
        }
        self.schedule.observe(state);
        for (lease, group) in self.leases.iter_mut().zip(&state.groups) {
            *lease = Lease::from_raw(group.lease);
        }
        self.count(published.is_err());
        if let Some(first_state) = self.first_state.take() {
            let _disconnected = first_state.send(());
        }
        true
    }

    /// Sends every state to the recorders, if there are any.
    fn record(&mut self) {
        let Self { ports, questions, records, .. } = self;
        let mut failed = false;
        questions.recorder.relay(ports.recorders().are_connected(), |port, state| {
            failed |= port.send(records.next(state)).is_err();
        });
        self.count(failed);
    }

    /// Takes new requests. Drops those whose requester gave up, because a client with too many
    /// requests under way can send no further one. A dropped request counts until its answer
    /// arrives.
    fn take_requests(&mut self) {
        self.requested.drop_unless(Request::is_awaited);
        self.questioned.drop_unless(Request::is_awaited);
        for _ in 0..REQUESTS_PER_WAKE {
            match self.ports.next_request() {
                Ok(Some(request)) => self.serve(request),
                Ok(None) => break,
                Err(_) => {
                    self.count(true);
                    break;
                }
            }
        }
    }

    fn serve(&mut self, request: Request) {
        let payload = *request.payload();
        match payload.operation() {
            Ok(Operation::Describe) => {
                self.answer(request, AdminReply::default(), self.description.as_bytes());
            }
            Ok(Operation::Telemetry | Operation::Histograms | Operation::ResetTelemetry) => {
                match self.questioned.keep(request, 0) {
                    Ok(ticket) => self.questions.ask(ticket, payload),
                    Err(request) => self.refuse(request, Refusal::Busy),
                }
            }
            operation => {
                self.questions.programs.note_request(&payload);
                let spare = if operation == Ok(Operation::EmergencyStop) { 0 } else { STOPS };
                match self.requested.keep(request, spare) {
                    Ok(ticket) => {
                        // The ring takes as many as are kept.
                        let _never_full = self.cycle.requests.push((ticket, payload));
                    }
                    Err(request) => self.refuse(request, Refusal::Busy),
                }
            }
        }
    }

    fn give_answers(&mut self) {
        while let Ok((ticket, reply)) = self.cycle.answers.pop() {
            let Some(request) = self.requested.take(ticket) else { continue };
            // The owner's first setpoint may come before the state that tells of its lease.
            if let Some(lease) = Lease::from_raw(reply.lease) {
                self.leases[lease.group()] = Some(lease);
                let owners = self.owners.as_mut();
                if owners.is_some_and(|owners| owners.watch(lease, request.payload())) {
                    self.cycle.counters.alarms.owner_ended(lease);
                }
            }
            self.questions.answered.note(self.cycle.states.output_buffer().cycle, request.payload(), reply);
            self.answer(request, reply, b"");
        }
        while let Some((ticket, text)) = self.questions.answer() {
            if let Some(request) = self.questioned.take(ticket) {
                self.answer(request, AdminReply::default(), text.as_bytes());
            }
        }
    }

    fn refuse(&self, request: Request, refusal: Refusal) {
        self.answer(request, AdminReply { lease: 0, refusal: refusal.code(), detail: NO_JOINT }, b"");
    }

    /// Sends the answer. It is dropped when the requester has disconnected.
    fn answer(&self, request: Request, reply: AdminReply, text: &[u8]) {
        let _disconnected = request.reply(reply, text);
    }

    fn count(&self, failed: bool) {
        if failed {
            self.cycle.counters.ipc_errors.fetch_add(1, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::telemetry;
    use motord_bus::Duration;
    use motord_ports::{ClientPorts, Instance, Question};

    /// The thread, with a cycle and a telemetry thread that answer nothing.
    fn unanswered(directory: &std::path::Path, test: impl FnOnce(&mut IpcThread, &ClientPorts)) {
        let instance = Instance::below(directory, "robot").unwrap();
        let lock = instance.lock().unwrap();
        let (_cycle, ends) = motord_core::cycle::link(1, 0);
        let (end, _telemetry, _supply) = CycleEnd::split(ends);
        let (questions, _answers) = telemetry::questions();
        let schedule = Schedule::new(Duration::from_millis(1), Duration::ZERO, Duration::ZERO);
        let ports = DaemonPorts::open(&lock).unwrap();
        let mut thread = IpcThread::new(
            ports,
            (end, None),
            questions,
            "{}".into(),
            IpcMode::Timed,
            schedule,
            Records::new(Vec::new()),
        );
        let client = ClientPorts::open_to_stop(instance.attach().unwrap().unwrap()).unwrap();
        test(&mut thread, &client);
    }

    fn ask(thread: &mut IpcThread, client: &ClientPorts, operation: Operation) -> Question {
        let question =
            client.ask(AdminRequest { operation: operation.code(), ..Default::default() }).unwrap();
        thread.turn();
        question
    }

    fn refusal(question: &Question) -> Option<u32> {
        question.answer().unwrap().map(|(reply, _)| reply.refusal)
    }

    #[test]
    fn retrying_client_leaves_slots_for_emergency_stops() {
        let directory = tempfile::tempdir().unwrap();
        unanswered(directory.path(), |thread, client| {
            for _ in 0..2 * REQUESTS_MAX {
                let _given_up = refusal(&ask(thread, client, Operation::Enable));
            }
            let refused = ask(thread, client, Operation::Enable);
            assert_eq!(refusal(&refused), Some(Refusal::Busy.code()));
            assert_eq!(refusal(&ask(thread, client, Operation::EmergencyStop)), None);
        });
    }

    #[test]
    fn abandoned_questions_are_bounded_and_block_nothing() {
        let directory = tempfile::tempdir().unwrap();
        unanswered(directory.path(), |thread, client| {
            for _ in 0..2 * QUESTIONS_MAX {
                let _given_up = refusal(&ask(thread, client, Operation::Telemetry));
            }
            let refused = ask(thread, client, Operation::Telemetry);
            assert_eq!(refusal(&refused), Some(Refusal::Busy.code()));
            assert_eq!(refusal(&ask(thread, client, Operation::Enable)), None);
        });
    }

    #[test]
    fn questions_of_dropped_requests_are_no_errors() {
        let directory = tempfile::tempdir().unwrap();
        unanswered(directory.path(), |thread, client| {
            let request = AdminRequest { operation: Operation::Describe.code(), ..Default::default() };
            for operation in [Operation::Describe, Operation::Telemetry, Operation::Enable] {
                for _ in 0..2 * QUESTIONS_MAX {
                    let request = AdminRequest { operation: operation.code(), ..Default::default() };
                    drop(client.ask(request).unwrap());
                    thread.turn();
                    drop(ask(thread, client, operation));
                }
            }
            let kept = client.ask(request).unwrap();
            thread.turn();
            assert_eq!(refusal(&kept), Some(0), "who waits is answered");
            assert_eq!(thread.cycle.counters.ipc_errors.load(Ordering::Relaxed), 0);
        });
    }
}
