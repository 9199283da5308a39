//! The ipc thread: owns every iceoryx2 port, and stands between the clients and the cycle.
//!
//! Not real-time: iceoryx2 allocates with every message and maps files when a client comes or goes. If this thread
//! stands still, setpoints grow old and the cycle damps the robot.

pub mod description;

use crate::telemetry::Questions;
use motord_bus::{Duration, Instant, clock};
use motord_core::cycle::{Counters, Ends, REQUESTS_MAX, Supply};
use motord_core::settings::{IpcMode, IpcSettings};
use motord_shared::limits::GROUPS_MAX;
use motord_shared::message::NO_JOINT;
use motord_shared::ports::{DaemonPorts, Request};
use motord_shared::{AdminReply, AdminRequest, Lease, Operation, Refusal, SetpointMessage, StateMessage};
use rtrb::{Consumer, Producer};
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Requests taken from clients each time the thread wakes.
const REQUESTS_PER_WAKE: usize = 64;

/// The cycle's other end, as far as clients are concerned.
pub struct CycleEnd {
    setpoints: Vec<triple_buffer::Input<SetpointMessage>>,
    states: triple_buffer::Output<StateMessage>,
    requests: Producer<(u32, AdminRequest)>,
    answers: Consumer<(u32, AdminReply)>,
    counters: Arc<Counters>,
}

impl CycleEnd {
    /// Divides `ends` into the clients' part, the telemetry's part, and the part of the thread that opens buses again.
    #[must_use]
    pub fn split(ends: Ends) -> (Self, crate::telemetry::CycleEnd, Supply) {
        let Ends { setpoints, states, requests, answers, records, events, counters, supply } = ends;
        let telemetry = crate::telemetry::CycleEnd { records, events, counters: Arc::clone(&counters) };
        (Self { setpoints, states, requests, answers, counters }, telemetry, supply)
    }
}

/// The ipc thread.
pub struct IpcThread {
    ports: DaemonPorts,
    cycle: CycleEnd,
    questions: Questions,
    description: String,
    period: Duration,
    mode: IpcMode,
    lead: Duration,
    waiting: Vec<(u32, Request)>,
    next_ticket: u32,
    leases: [Option<Lease>; GROUPS_MAX],
    tick: Instant,
}

impl IpcThread {
    /// Everything in place. `description` is the answer to [`Operation::Describe`].
    #[must_use]
    pub fn new(
        ports: DaemonPorts,
        cycle: CycleEnd,
        questions: Questions,
        description: String,
        settings: &IpcSettings,
        period: Duration,
    ) -> Self {
        Self {
            ports,
            cycle,
            questions,
            description,
            period,
            mode: settings.mode,
            lead: settings.lead,
            waiting: Vec::with_capacity(REQUESTS_MAX),
            next_ticket: 0,
            leases: [None; GROUPS_MAX],
            tick: Instant::ZERO,
        }
    }

    /// Runs until `stop` says so.
    pub fn run(&mut self, stop: impl Fn() -> bool) {
        while !stop() {
            self.turn();
            self.wait();
        }
        // The last states tell the clients that the daemon is leaving.
        self.turn();
    }

    fn turn(&mut self) {
        self.fetch_setpoints();
        self.publish_states();
        self.take_requests();
        self.give_answers();
    }

    /// In timed mode the cycle ends this sleep when its states are ready; else it lasts until `lead` before the next
    /// cycle, so that a setpoint sent by then is used in that cycle.
    fn wait(&self) {
        if self.mode == IpcMode::Spin {
            std::hint::spin_loop();
            return;
        }
        let now = clock::monotonic();
        let fetch = self.tick + self.period - self.lead;
        let fetch = if fetch > now { fetch } else { fetch + self.period };
        std::thread::park_timeout(fetch.since(now).clamp(Duration::from_micros(1), self.period));
    }

    fn fetch_setpoints(&mut self) {
        let Self { ports, cycle, leases, .. } = self;
        let taken = ports.take_setpoint(|message| {
            let Some(lease) = Lease::from_raw(message.lease) else { return };
            let Some(buffer) = cycle.setpoints.get_mut(lease.group()) else { return };
            // Another's message would push the owner's out of the buffer, so it is counted here and goes no further.
            if leases[lease.group()] == Some(lease) {
                *buffer.input_buffer_mut() = *message;
                buffer.publish();
            } else {
                cycle.counters.wrong_lease[lease.group()].fetch_add(1, Ordering::Relaxed);
            }
        });
        self.count(taken.is_err());
    }

    fn publish_states(&mut self) {
        if !self.cycle.states.update() {
            return;
        }
        let state = self.cycle.states.output_buffer();
        self.tick = Instant::from_nanos(state.tick_ns);
        for (lease, group) in self.leases.iter_mut().zip(&state.groups) {
            *lease = Lease::from_raw(group.lease);
        }
        let published = self.ports.publish(state).and_then(|()| self.ports.notify());
        self.count(published.is_err());
    }

    /// Requests whose asker gave up are dropped: iceoryx2 takes no further request of a client while so many are kept.
    fn take_requests(&mut self) {
        self.waiting.retain(|(_, request)| request.is_awaited());
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
            _ if self.waiting.len() >= REQUESTS_MAX => self.refuse(request, Refusal::Busy),
            Ok(Operation::Telemetry) => {
                let ticket = self.await_answer(request);
                self.questions.ask(ticket);
            }
            _ => {
                let ticket = self.await_answer(request);
                if self.cycle.requests.push((ticket, payload)).is_err() {
                    self.take_waiting(ticket)
                        .into_iter()
                        .for_each(|request| self.refuse(request, Refusal::Busy));
                }
            }
        }
    }

    fn await_answer(&mut self, request: Request) -> u32 {
        self.next_ticket = self.next_ticket.wrapping_add(1);
        self.waiting.push((self.next_ticket, request));
        self.next_ticket
    }

    fn take_waiting(&mut self, ticket: u32) -> Option<Request> {
        let place = self.waiting.iter().position(|(waiting, _)| *waiting == ticket)?;
        Some(self.waiting.swap_remove(place).1)
    }

    fn give_answers(&mut self) {
        while let Ok((ticket, reply)) = self.cycle.answers.pop() {
            let Some(request) = self.take_waiting(ticket) else { continue };
            // The owner's first setpoint may come before the state that tells of its lease.
            if let Some(lease) = Lease::from_raw(reply.lease) {
                self.leases[lease.group()] = Some(lease);
            }
            self.answer(request, reply, b"");
        }
        while let Some((ticket, text)) = self.questions.answer() {
            if let Some(request) = self.take_waiting(ticket) {
                self.answer(request, AdminReply::default(), text.as_bytes());
            }
        }
    }

    fn refuse(&self, request: Request, refusal: Refusal) {
        self.answer(request, AdminReply { lease: 0, refusal: refusal.code(), detail: NO_JOINT }, b"");
    }

    /// An asker that is gone by now misses its answer, and nobody else cares.
    fn answer(&self, request: Request, reply: AdminReply, text: &[u8]) {
        let _gone = request.reply(reply, text);
    }

    fn count(&self, failed: bool) {
        if failed {
            self.cycle.counters.ipc_errors.fetch_add(1, Ordering::Relaxed);
        }
    }
}
