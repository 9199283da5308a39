//! The telemetry thread: takes in what the cycle measured and did, answers questions about it, and
//! does what is not urgent.
//!
//! | type | job |
//! |---|---|
//! | `Measurements` | histograms and metrics |
//! | `Log` | the lines of the log about events and requests |
//! | `Groups` | owners and stops of the groups, for the answers |
//! | `UnexpectedCounts` | frames with unexpected ids |
//! | [`BusWatch`] | buses that must be opened again |
//! | [`Housekeeping`] | dead clients, the runtime directory, the configuration file, memory for recorders |
//!
//! No thread waits for it. Records and events that it is too slow for are dropped and counted.

mod groups;
mod log;
mod measurements;
pub mod programs;
mod questions;
mod recordings;
mod registers;
mod unexpected;

use crate::buses::watch::BusWatch;
use crate::housekeeping::{ConfigWatch, DeadClients, DirectoryGuard};
use groups::Groups;
use log::Log;
use measurements::Measurements;
use motord_bus::Duration;
use motord_core::control::Event;
use motord_core::cycle::{Counters, Histories, Record};
use motord_metrics::Outputs;
use motord_ports::Recorders;
use motord_settings::settings::Settings;
use motord_shared::{AdminReply, AdminRequest, BusCondition, MotorMode, Operation};
use questions::Asked;
pub use questions::{Answers, Questions, questions};
pub use recordings::Recorder;
use rtrb::Consumer;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::RecvTimeoutError;
use std::thread::Thread;
use unexpected::UnexpectedCounts;

/// Period of the thread.
const TURN: Duration = Duration::from_millis(50);
/// Period of the checks that take longer.
const CHORES: Duration = Duration::from_secs(1);

/// The cycle's other end, as far as telemetry is concerned.
pub struct CycleEnd {
    /// One per cycle.
    pub records: Consumer<Record>,
    /// With the number of their cycle.
    pub events: Consumer<(u64, Event)>,
    /// Queues for recorders.
    pub histories: Histories,
    /// Counters.
    pub counters: Arc<Counters>,
}

/// Work beside the measurements, at the pace of this thread.
pub struct Housekeeping {
    /// Stops the robot when its files are lost.
    pub directory: DirectoryGuard,
    /// Reports a changed configuration file.
    pub config: ConfigWatch,
    /// Reports broken buses.
    pub buses: BusWatch,
    /// The recorders that are connected.
    pub recorders: Recorders,
}

/// Everything that the telemetry thread owns.
pub struct TelemetryLoop {
    events: Consumer<(u64, Event)>,
    histories: Histories,
    counters: Arc<Counters>,
    answers: Answers,
    /// Woken when an answer is ready.
    ipc_thread: Thread,
    measurements: Measurements,
    groups: Groups,
    log: Log,
    unexpected_ids: UnexpectedCounts,
    /// The bus of each motor.
    motor_buses: Vec<usize>,
    housekeeping: Housekeeping,
}

impl TelemetryLoop {
    /// Takes the ends of the cycle and of the ipc thread. The metrics go to `outputs`.
    #[must_use]
    pub fn new(
        settings: &Settings,
        cycle: CycleEnd,
        (answers, ipc_thread): (Answers, Thread),
        housekeeping: Housekeeping,
        outputs: Option<Outputs>,
    ) -> Self {
        let CycleEnd { records, events, histories, counters } = cycle;
        Self {
            events,
            histories,
            answers,
            ipc_thread,
            measurements: Measurements::new(settings, records, Arc::clone(&counters), outputs),
            counters,
            groups: Groups::new(settings.groups.len()),
            log: Log::new(settings),
            unexpected_ids: UnexpectedCounts::new(settings),
            motor_buses: settings.motors.iter().map(|motor| motor.bus).collect(),
            housekeeping,
        }
    }

    /// Runs until `stop` returns true.
    pub fn run(&mut self, mut dead_clients: DeadClients, stop: impl Fn() -> bool) {
        self.unexpected_ids.open();
        let mut done = motord_bus::clock::monotonic();
        while !stop() {
            match self.answers.questions.recv_timeout(TURN) {
                Ok((ticket, request)) => self.answer(ticket, &request),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(TURN),
            }
            self.turn();
            self.serve_recorders();
            self.housekeeping.directory.check(&stop);
            dead_clients.clean();
            let now = motord_bus::clock::monotonic();
            if now.since(done) >= CHORES {
                done = now;
                self.do_chores();
            }
        }
        self.turn();
        self.log.log_counts(&self.counters);
        self.log.log_missed_ticks();
    }

    fn turn(&mut self) {
        self.measurements.take(&mut self.answers);
        while let Ok((cycle, event)) = self.events.pop() {
            self.log_requests(cycle);
            if let Event::Bus { bus, condition } = event {
                if condition == BusCondition::Gone {
                    self.unexpected_ids.close(bus);
                }
                self.housekeeping.buses.record(bus, condition);
            }
            if let Event::Silent { motor } | Event::Motor { motor, mode: MotorMode::Offline } = event {
                self.unexpected_ids.search(self.motor_buses[motor]);
            }
            self.groups.record(cycle, event, &self.answers.programs);
            self.measurements.record(event);
            self.log.log(cycle, event, &self.answers.programs);
        }
        self.housekeeping.buses.turn();
        self.log_requests(u64::MAX);
        self.unexpected_ids.store(&self.counters);
    }

    fn serve_recorders(&mut self) {
        let Self { answers, histories, housekeeping, .. } = self;
        if answers.recordings.turn(histories, &housekeeping.recorders).is_err() {
            self.counters.ipc_errors.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn do_chores(&mut self) {
        self.log.log_counts(&self.counters);
        self.housekeeping.buses.report_off();
        self.unexpected_ids.open();
        let Self { unexpected_ids, log, .. } = self;
        unexpected_ids.step_searches(|found| log.log_other_formats(found));
        self.housekeeping.config.check();
        self.measurements.expose(self.answers.states.read());
    }

    /// Logs the requests that were answered before `cycle`.
    fn log_requests(&mut self, cycle: u64) {
        while self.answers.asked.peek().is_ok_and(|asked| asked.cycle < cycle) {
            if let Ok(asked) = self.answers.asked.pop() {
                self.log.log_request(&asked, &self.answers.programs);
            }
        }
    }

    fn answer(&mut self, ticket: u32, request: &AdminRequest) {
        self.turn();
        let text = match request.operation() {
            Ok(Operation::Histograms) => self.measurements.histograms(request.argument as usize),
            Ok(Operation::ResetTelemetry) => {
                self.reset(request);
                String::new()
            }
            _ => self.measurements.telemetry(self.groups.history()),
        };
        let _disconnected = self.answers.answers.send((ticket, text));
        self.ipc_thread.unpark();
    }

    fn reset(&mut self, request: &AdminRequest) {
        self.measurements.reset();
        // The requester waits for its answer, so its program can still be read.
        self.answers.programs.note_request(request);
        let cycle = self.counters.cycle.load(Ordering::Relaxed);
        let asked = Asked { cycle, request: *request, reply: AdminReply::default() };
        self.log.log_request(&asked, &self.answers.programs);
    }
}
