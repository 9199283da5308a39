//! The telemetry thread: histograms, the log, frames with unexpected ids, the watchdog of systemd, and the cleaning up after
//! dead clients.
//!
//! Nothing waits for it. Records and events that it is too slow for are dropped and counted.

mod asked;
pub mod askers;
mod distributions;
mod groups;
mod log;
mod unexpected;

use crate::host::systemd;
pub use asked::Answered;
use asked::Asked;
use askers::Askers;
use distributions::Distributions;
use groups::Groups;
use log::Log;
use motord_bus::Duration;
use motord_configuration as config;
use motord_core::control::Event;
use motord_core::cycle::{Counters, Record};
use motord_core::settings::Settings;
use motord_shared::ports::Housekeeper;
use motord_shared::{BusCondition, Cause, Presence};
use rtrb::Consumer;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, OnceLock};
use std::thread::Thread;
use unexpected::UnexpectedCounts;

/// Period of the thread.
const TURN: Duration = Duration::from_millis(50);
/// Period of cleaning up after dead clients, and of feeding systemd's watchdog.
const CLEANING: Duration = Duration::from_secs(1);

/// The cycle's other end, as far as telemetry is concerned.
pub struct CycleEnd {
    /// One per cycle.
    pub records: Consumer<Record>,
    /// With the number of their cycle.
    pub events: Consumer<(u64, Event)>,
    /// Counters.
    pub counters: Arc<Counters>,
}

/// The ipc thread's way to ask for telemetry without waiting for it.
pub struct Questions {
    /// The processes that ask, for the log.
    pub askers: Askers,
    /// Takes the requests that were answered, for the log.
    pub answered: Answered,
    questions: Sender<u32>,
    answers: Receiver<(u32, String)>,
}

impl Questions {
    /// Asks; the answer will bear the same ticket. Without a telemetry thread it never comes. The asker bounds how many
    /// questions are open.
    pub fn ask(&self, ticket: u32) {
        let _lost = self.questions.send(ticket);
    }

    /// The next answer, if there is one.
    #[must_use]
    pub fn answer(&self) -> Option<(u32, String)> {
        self.answers.try_recv().ok()
    }
}

/// The telemetry thread's end of the questions.
pub struct Answers {
    asked: Consumer<Asked>,
    askers: Askers,
    questions: Receiver<u32>,
    answers: Sender<(u32, String)>,
}

/// Both ends of the questions.
#[must_use]
pub fn questions() -> (Questions, Answers) {
    let (question_sender, question_receiver) = channel();
    let (answer_sender, answer_receiver) = channel();
    let (answered, asked) = asked::asked();
    let askers = Askers::default();
    let answers =
        Answers { asked, askers: askers.clone(), questions: question_receiver, answers: answer_sender };
    (Questions { askers, answered, questions: question_sender, answers: answer_receiver }, answers)
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
    groups: Groups,
    log: Log,
    unexpected_ids: UnexpectedCounts,
    watched_cycle: u64,
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
            groups: Groups::new(settings.groups.len()),
            log: Log::new(settings),
            unexpected_ids: UnexpectedCounts::new(settings),
            ipc_thread: None,
            config: None,
            broken: None,
            off: Vec::new(),
            watched_cycle: 0,
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

    /// Runs until `stop` says so. `housekeeper` is missing when it could not be opened: then the dead keep their places.
    pub fn run(&mut self, housekeeper: Option<&Housekeeper>, stop: impl Fn() -> bool) {
        self.unexpected_ids.open();
        let mut cleaned = motord_bus::clock::monotonic();
        while !stop() {
            match self.answers.questions.recv_timeout(TURN) {
                Ok(ticket) => self.answer(ticket),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(TURN),
            }
            self.turn();
            self.guard_presence(&stop);
            let now = motord_bus::clock::monotonic();
            if now.since(cleaned) >= CLEANING {
                cleaned = now;
                let _removed = housekeeper.map(Housekeeper::clean);
                self.log.log_counts(&self.cycle.counters);
                self.report_off();
                self.unexpected_ids.open();
                self.watch_config();
                self.feed_watchdog();
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
        while let Ok((cycle, event)) = self.cycle.events.pop() {
            self.log_requests(cycle);
            if let Event::Bus { bus, condition } = event {
                self.watch_bus(bus, condition);
            }
            self.groups.record(cycle, event, &self.answers.askers);
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
        // Asked after the look: whoever removes them was told to end before.
        if ends() {
            return;
        }
        tracing::error!("{} was removed or replaced: no new client can reach this daemon", path.display());
        // Before the order to leave, which would be the cause else.
        self.cycle.counters.alarms.stop(Cause::DirectoryLost);
        let _not_the_first = self.lost.set(path);
        self.presence = None;
    }

    fn answer(&mut self, ticket: u32) {
        self.turn();
        let mut telemetry = self.distributions.telemetry();
        telemetry.groups = self.groups.history();
        telemetry.dropped_records = self.cycle.counters.dropped.load(Ordering::Relaxed);
        let text = serde_json::to_string(&telemetry).expect("numbers and lists of them are JSON");
        let _gone = self.answers.answers.send((ticket, text));
        if let Some(thread) = &self.ipc_thread {
            thread.unpark();
        }
    }

    fn watch_config(&mut self) {
        let Some((path, hash)) = &self.config else { return };
        let changed = config::has_changed(path, *hash);
        let known = self.cycle.counters.config_changed.swap(changed, Ordering::Relaxed);
        if changed && !known {
            tracing::warn!("{} was changed: it is read again when the daemon is restarted", path.display());
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

    /// A controller that left its bus comes back by itself where `restart-ms` is set; else it is set up again.
    fn report_off(&mut self) {
        let off = std::mem::take(&mut self.off);
        off.into_iter().for_each(|bus| self.report_broken(bus));
    }

    fn report_broken(&self, bus: usize) {
        if let Some(broken) = &self.broken {
            let _ended = broken.send(bus);
        }
    }

    /// Only while the cycle moves: a watchdog that is fed by a thread of its own proves nothing.
    fn feed_watchdog(&mut self) {
        let cycle = self.cycle.counters.cycle.load(Ordering::Acquire);
        if cycle != std::mem::replace(&mut self.watched_cycle, cycle) {
            systemd::feed_watchdog();
        }
    }
}
