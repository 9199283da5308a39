//! The telemetry thread: histograms, the log, frames with unexpected ids, and the cleaning up after dead clients.
//!
//! Nothing waits for it. Records and events that it is too slow for are dropped and counted.

mod asked;
pub mod askers;
mod groups;
mod log;
mod questions;
mod unexpected;

use asked::Asked;
use groups::Groups;
use log::Log;
use motord_bus::Duration;
use motord_configuration as config;
use motord_core::control::Event;
use motord_core::cycle::{Counters, Record};
use motord_core::settings::Settings;
use motord_metrics::{Distributions, Metrics, Names, Outputs};
use motord_ports::{Housekeeper, Presence};
use motord_shared::{AdminReply, AdminRequest, BusCondition, Cause, Operation};
pub use questions::{Answers, Questions, questions};
use rtrb::Consumer;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::mpsc::{RecvTimeoutError, Sender};
use std::sync::{Arc, OnceLock};
use std::thread::Thread;
use unexpected::UnexpectedCounts;

/// Period of the thread.
const TURN: Duration = Duration::from_millis(50);
/// Period of cleaning up after dead clients: one that is started again and again must find a place.
const CLEANING: Duration = Duration::from_millis(250);
/// Period of what is done now and then.
const CHORES: Duration = Duration::from_secs(1);

/// The cycle's other end, as far as telemetry is concerned.
pub struct CycleEnd {
    /// One per cycle.
    pub records: Consumer<Record>,
    /// With the number of their cycle.
    pub events: Consumer<(u64, Event)>,
    /// Counters.
    pub counters: Arc<Counters>,
}

/// Everything the telemetry thread knows.
pub struct Recorder {
    cycle: CycleEnd,
    answers: Answers,
    ipc_thread: Option<Thread>,
    config: Option<(PathBuf, u64)>,
    broken: Option<Sender<usize>>,
    off: Vec<usize>,
    distributions: Distributions,
    metrics: Metrics,
    outputs: Option<Outputs>,
    groups: Groups,
    log: Log,
    unexpected_ids: UnexpectedCounts,
    presence: Option<Presence>,
    /// The first file of the runtime directory that was lost.
    lost: Arc<OnceLock<PathBuf>>,
}

impl Recorder {
    /// Everything in place.
    #[must_use]
    pub fn new(settings: &Settings, cycle: CycleEnd, answers: Answers) -> Self {
        Self {
            cycle,
            answers,
            distributions: Distributions::new(
                settings.motors.len(),
                settings.groups.len(),
                settings.cycle.period,
            ),
            metrics: Metrics::new(Names::of(settings)),
            outputs: None,
            groups: Groups::new(settings.groups.len()),
            log: Log::new(settings),
            unexpected_ids: UnexpectedCounts::new(settings),
            ipc_thread: None,
            config: None,
            broken: None,
            off: Vec::new(),
            presence: None,
            lost: Arc::default(),
        }
    }

    /// The thread to wake when an answer is ready.
    pub fn wakes(&mut self, ipc_thread: Thread) {
        self.ipc_thread = Some(ipc_thread);
    }

    /// The configuration's file and its hash, to be watched.
    pub fn watches(&mut self, config: PathBuf, hash: u64) {
        self.config = Some((config, hash));
    }

    /// Reports the buses that must be opened again to `broken`.
    pub fn reports_broken(&mut self, broken: Sender<usize>) {
        self.broken = Some(broken);
    }

    /// Stops the robot when one of these files is gone. Returns where the first will be.
    pub fn guards(&mut self, presence: Presence) -> Arc<OnceLock<PathBuf>> {
        self.presence = Some(presence);
        Arc::clone(&self.lost)
    }

    /// Hands the metrics to `outputs` once a second.
    pub fn exposes(&mut self, outputs: Option<Outputs>) {
        self.outputs = outputs;
    }

    /// Runs until `stop` returns true. Without a `housekeeper`, which could not be opened then, dead clients keep their places.
    pub fn run(&mut self, housekeeper: Option<&Housekeeper>, stop: impl Fn() -> bool) {
        self.unexpected_ids.open();
        let begun = motord_bus::clock::monotonic();
        let (mut cleaned, mut done) = (begun, begun);
        while !stop() {
            match self.answers.questions.recv_timeout(TURN) {
                Ok((ticket, request)) => self.answer(ticket, &request),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(TURN),
            }
            self.turn();
            self.guard_presence(&stop);
            let now = motord_bus::clock::monotonic();
            if now.since(cleaned) >= CLEANING {
                cleaned = now;
                let _removed = housekeeper.map(Housekeeper::clean);
            }
            if now.since(done) >= CHORES {
                done = now;
                self.log.log_counts(&self.cycle.counters);
                self.report_off();
                self.unexpected_ids.open();
                self.watch_config();
                self.expose();
            }
        }
        self.turn();
        self.log.log_counts(&self.cycle.counters);
        self.log.log_missed_ticks();
    }

    fn turn(&mut self) {
        while let Ok(record) = self.cycle.records.pop() {
            self.distributions.record(&record);
        }
        while let Ok(delivery) = self.answers.deliveries.pop() {
            self.distributions.record_delivery(delivery);
        }
        while let Ok((cycle, event)) = self.cycle.events.pop() {
            self.log_requests(cycle);
            if let Event::Bus { bus, condition } = event {
                self.watch_bus(bus, condition);
            }
            self.groups.record(cycle, event, &self.answers.askers);
            self.metrics.record(event);
            self.log.log(cycle, event, &self.answers.askers);
        }
        self.log_requests(u64::MAX);
        self.unexpected_ids.store(&self.cycle.counters);
    }

    /// Logs the requests that were answered before `cycle`.
    fn log_requests(&mut self, cycle: u64) {
        while self.answers.asked.peek().is_ok_and(|asked| asked.cycle < cycle) {
            if let Ok(asked) = self.answers.asked.pop() {
                self.log.log_request(&asked, &self.answers.askers);
            }
        }
    }

    /// Some system calls that do not block. A daemon that ends, as `ends` tells, removes its files itself.
    fn guard_presence(&mut self, ends: impl Fn() -> bool) {
        let Some(path) = self.presence.as_ref().and_then(Presence::lost).map(Path::to_owned) else { return };
        // Asked after the look at the files: a daemon that ends has its order before it removes them.
        if ends() {
            return;
        }
        tracing::error!(
            see = "directory-lost",
            "{} was removed or replaced: no new client can reach this daemon",
            path.display()
        );
        // Given first: `lost` makes the main thread order a stop, and then that order would be the cause.
        self.cycle.counters.alarms.stop(Cause::DirectoryLost);
        let _not_the_first = self.lost.set(path);
        self.presence = None;
    }

    fn answer(&mut self, ticket: u32, request: &AdminRequest) {
        self.turn();
        let text = match request.operation() {
            Ok(Operation::Histograms) => {
                let Names { joints, groups, .. } = self.metrics.names();
                json(&self.distributions.histograms(request.argument as usize, joints, groups))
            }
            Ok(Operation::ResetTelemetry) => {
                self.reset(request);
                String::new()
            }
            _ => self.telemetry(),
        };
        let _gone = self.answers.answers.send((ticket, text));
        if let Some(thread) = &self.ipc_thread {
            thread.unpark();
        }
    }

    fn telemetry(&self) -> String {
        let mut telemetry = self.distributions.telemetry(self.dropped());
        telemetry.groups = self.groups.history();
        json(&telemetry)
    }

    fn reset(&mut self, request: &AdminRequest) {
        self.distributions.reset(self.dropped());
        // The asker waits for its answer, so it is still there to be named.
        self.answers.askers.note(request.pid);
        let cycle = self.cycle.counters.cycle.load(Ordering::Relaxed);
        let asked = Asked { cycle, request: *request, reply: AdminReply::default() };
        self.log.log_request(&asked, &self.answers.askers);
    }

    fn dropped(&self) -> u64 {
        self.cycle.counters.dropped.load(Ordering::Relaxed)
    }

    fn expose(&mut self) {
        if let Some(outputs) = &self.outputs {
            let dropped = self.dropped();
            outputs.publish(self.metrics.text(&self.distributions, self.answers.states.read(), dropped));
        }
    }

    fn watch_config(&mut self) {
        let Some((path, hash)) = &self.config else { return };
        let changed = config::has_changed(path, *hash);
        let known = self.cycle.counters.config_changed.swap(changed, Ordering::Relaxed);
        if changed && !known {
            tracing::warn!(
                see = "config-changed",
                "{} was changed: it is read again when the daemon is restarted",
                path.display()
            );
        }
    }

    fn watch_bus(&mut self, bus: usize, condition: BusCondition) {
        self.off.retain(|off| *off != bus);
        match condition {
            BusCondition::Gone => {
                self.unexpected_ids.close(bus);
                self.report_broken(bus);
            }
            BusCondition::Off => self.off.push(bus),
            _ => {}
        }
    }

    /// A controller that left its bus comes back by itself where `restart-ms` is set. A bus that is still off is reported.
    fn report_off(&mut self) {
        let off = std::mem::take(&mut self.off);
        off.into_iter().for_each(|bus| self.report_broken(bus));
    }

    fn report_broken(&self, bus: usize) {
        if let Some(broken) = &self.broken {
            let _ended = broken.send(bus);
        }
    }
}

fn json(answer: &impl Serialize) -> String {
    serde_json::to_string(answer).expect("numbers, texts and lists of them are JSON")
}
