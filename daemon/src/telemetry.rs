//! The telemetry thread: histograms, the log, the watchdog of systemd, and the cleaning up after dead clients.
//!
//! Nothing waits for it. What the cycle tells faster than it can be taken is dropped and counted.

use crate::config::{self, settings::Settings};
use crate::control::Event;
use crate::cycle::{Counters, Record};
use hdrhistogram::Histogram;
use motord_bus::{Duration, Instant};
use motord_shared::BusCondition;
use motord_shared::ports::Housekeeper;
use motord_shared::roster::{Percentiles, Telemetry};
use rtrb::Consumer;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::Thread;

/// How often the thread looks after everything.
const TURN: Duration = Duration::from_millis(50);
/// How often it cleans up after dead clients, and tells systemd that the cycle lives.
const CLEANING: Duration = Duration::from_secs(1);
/// Latencies beyond it are recorded as it: 10 s.
const LATENCY_MAX_NS: u64 = 10_000_000_000;

/// The cycle's other end, as far as telemetry is concerned.
pub struct CycleEnd {
    /// One per cycle.
    pub records: Consumer<Record>,
    /// With the number of their cycle.
    pub events: Consumer<(u64, Event)>,
    /// Counters.
    pub counters: Arc<Counters>,
}

/// How the exchange asks for telemetry without waiting for it.
pub struct Questions {
    questions: Sender<u32>,
    answers: Receiver<(u32, String)>,
}

impl Questions {
    /// Asks; the answer will bear the same ticket. Without a telemetry thread it never comes.
    pub fn ask(&self, ticket: u32) {
        let _lost = self.questions.send(ticket);
    }

    /// The next answer, if there is one.
    #[must_use]
    pub fn answer(&self) -> Option<(u32, String)> {
        self.answers.try_recv().ok()
    }
}

/// Where the telemetry thread hears questions.
pub struct Answers {
    questions: Receiver<u32>,
    answers: Sender<(u32, String)>,
}

/// Both ends of the questions.
#[must_use]
pub fn questions() -> (Questions, Answers) {
    let (question_sender, question_receiver) = channel();
    let (answer_sender, answer_receiver) = channel();
    let questions = Questions { questions: question_sender, answers: answer_receiver };
    (questions, Answers { questions: question_receiver, answers: answer_sender })
}

/// What the telemetry thread knows.
pub struct Recorder {
    cycle: CycleEnd,
    answers: Answers,
    names: Names,
    exchange: Option<Thread>,
    config: Option<(PathBuf, u64)>,
    broken: Option<Sender<usize>>,
    off: Vec<usize>,
    distributions: Distributions,
    skipped: u64,
    told_dropped: u64,
    told_errors: u64,
    watched_cycle: u64,
}

/// What events are about, for people.
struct Names {
    motors: Vec<String>,
    groups: Vec<String>,
    buses: Vec<String>,
}

/// Latency distributions since the start.
struct Distributions {
    totals: Telemetry,
    first: Option<Instant>,
    last: Instant,
    wake: Histogram<u64>,
    reply: Histogram<u64>,
    setpoint_age: Histogram<u64>,
    cycle: Histogram<u64>,
    joints: Vec<Histogram<u64>>,
    period: Duration,
}

impl Recorder {
    /// Everything in place.
    #[must_use]
    pub fn new(settings: &Settings, cycle: CycleEnd, answers: Answers) -> Self {
        let names = Names {
            motors: settings.motors.iter().map(|motor| motor.name.clone()).collect(),
            groups: settings.groups.iter().map(|group| group.name.clone()).collect(),
            buses: settings.buses.iter().map(|bus| bus.name.clone()).collect(),
        };
        Self {
            cycle,
            answers,
            distributions: Distributions::new(settings.motors.len(), settings.cycle.period),
            names,
            exchange: None,
            config: None,
            broken: None,
            off: Vec::new(),
            skipped: 0,
            told_dropped: 0,
            told_errors: 0,
            watched_cycle: 0,
        }
    }

    /// The thread to wake when an answer is ready.
    pub fn wakes(&mut self, exchange: Thread) {
        self.exchange = Some(exchange);
    }

    /// The configuration's file and its hash, to be watched.
    pub fn watches(&mut self, config: PathBuf, hash: u64) {
        self.config = Some((config, hash));
    }

    /// Where to tell of buses that must be opened again.
    pub fn reports_broken(&mut self, broken: Sender<usize>) {
        self.broken = Some(broken);
    }

    /// Runs until `stop` says so. `housekeeper` is missing when it could not be opened: then the dead keep their places.
    pub fn run(&mut self, housekeeper: Option<&Housekeeper>, stop: impl Fn() -> bool) {
        let mut cleaned = motord_bus::clock::monotonic();
        while !stop() {
            match self.answers.questions.recv_timeout(TURN) {
                Ok(ticket) => self.answer(ticket),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(TURN),
            }
            self.turn();
            let now = motord_bus::clock::monotonic();
            if now.since(cleaned) >= CLEANING {
                cleaned = now;
                let _removed = housekeeper.map(Housekeeper::clean);
                self.tell_once_a_second();
                self.report_off();
                self.watch_config();
                self.feed_watchdog();
            }
        }
        self.turn();
        self.tell_once_a_second();
    }

    fn turn(&mut self) {
        while let Ok(record) = self.cycle.records.pop() {
            self.distributions.record(&record);
        }
        while let Ok((cycle, event)) = self.cycle.events.pop() {
            self.tell(cycle, event);
        }
    }

    fn answer(&mut self, ticket: u32) {
        self.turn();
        let mut telemetry = self.distributions.telemetry();
        telemetry.dropped_records = self.cycle.counters.dropped.load(Ordering::Relaxed);
        let text = serde_json::to_string(&telemetry).expect("numbers and lists of them are JSON");
        let _gone = self.answers.answers.send((ticket, text));
        if let Some(exchange) = &self.exchange {
            exchange.unpark();
        }
    }

    fn tell(&mut self, cycle: u64, event: Event) {
        let Names { motors, groups, buses } = &self.names;
        match event {
            Event::Motor { motor, mode } => {
                tracing::info!(cycle, motor = motors[motor], mode = mode.name(), "{}", mode.sentence());
            }
            Event::Silent { motor } => tracing::error!(
                cycle,
                motor = motors[motor],
                "has never answered: check its power and wiring, its id (ConfID 0x12) and host id (ConfID 0x13), the bit \
                 rate (0x18), and that it speaks the configured protocol (0x1C: 1 is MIT)"
            ),
            Event::Fault { motor, bits: 0 } => {
                tracing::info!(cycle, motor = motors[motor], "no fault any more");
            }
            Event::Fault { motor, bits } => {
                let bits = motord_protocol::FaultBits(bits);
                let sentences: Vec<_> = bits.named().map(|fault| fault.sentence).collect();
                tracing::error!(
                    cycle,
                    motor = motors[motor],
                    bits = bits.0,
                    "motor fault: {}",
                    sentences.join(" ")
                );
            }
            Event::Group { group, phase } => {
                tracing::info!(cycle, group = groups[group], phase = phase.name(), "{}", phase.sentence());
            }
            Event::Stopped { group, cause, motor } => {
                let motor = motor.map_or("-", |motor| &motors[motor]);
                tracing::error!(
                    cycle,
                    group = groups[group],
                    motor,
                    cause = cause.name(),
                    "{} The group is damped and stopped; it stays so until it is reset and enabled.",
                    cause.sentence()
                );
            }
            Event::Reset { group } => tracing::info!(cycle, group = groups[group], "reset"),
            Event::Owner { group, pid: Some(pid) } => {
                tracing::info!(cycle, group = groups[group], pid, "claimed");
            }
            Event::Owner { group, pid: None } => tracing::info!(cycle, group = groups[group], "has no owner"),
            Event::Bus { bus, condition } => {
                self.off.retain(|off| *off != bus);
                match condition {
                    BusCondition::Gone => self.report_broken(bus),
                    BusCondition::Off => self.off.push(bus),
                    _ => {}
                }
                tracing::warn!(
                    cycle,
                    bus = buses[bus],
                    condition = condition.name(),
                    "{}",
                    condition.sentence()
                );
            }
            Event::Overrun { skipped } => self.skipped += skipped,
        }
    }

    fn tell_once_a_second(&mut self) {
        let skipped = std::mem::take(&mut self.skipped);
        if skipped > 0 {
            tracing::warn!(skipped, "cycles were skipped: the cycle thread woke up too late");
        }
        let dropped = self.cycle.counters.dropped.load(Ordering::Relaxed);
        if dropped > std::mem::replace(&mut self.told_dropped, dropped) {
            tracing::warn!(dropped, "telemetry could not keep up: records were dropped");
        }
        let errors = self.cycle.counters.exchange_errors.load(Ordering::Relaxed);
        if errors > std::mem::replace(&mut self.told_errors, errors) {
            tracing::error!(
                errors,
                "the exchange with clients failed: are its files damaged, or is the disk full?"
            );
        }
    }

    fn watch_config(&mut self) {
        let Some((path, hash)) = &self.config else { return };
        let changed = config::has_changed(path, *hash);
        if changed && !self.cycle.counters.config_changed.swap(changed, Ordering::Relaxed) {
            tracing::warn!("{} was changed: it is read again when the daemon is restarted", path.display());
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
            let _no_systemd = sd_notify::notify(&[sd_notify::NotifyState::Watchdog]);
        }
    }
}

impl Distributions {
    fn new(joints: usize, period: Duration) -> Self {
        let histogram = || {
            Histogram::new_with_bounds(1, LATENCY_MAX_NS, 3).expect("1 and 10 s are bounds of a histogram")
        };
        Self {
            totals: Telemetry::default(),
            first: None,
            last: Instant::ZERO,
            wake: histogram(),
            reply: histogram(),
            setpoint_age: histogram(),
            cycle: histogram(),
            joints: (0..joints).map(|_| histogram()).collect(),
            period,
        }
    }

    fn record(&mut self, record: &Record) {
        self.totals.cycles += 1;
        self.totals.overruns += record.skipped;
        self.totals.missed_replies = record.missed;
        self.first.get_or_insert(record.scheduled);
        self.last = record.scheduled;
        self.wake.saturating_record(record.wake_latency_ns);
        self.cycle.saturating_record(record.cycle_ns);
        if let Some(age) = record.setpoint_age_ns {
            self.setpoint_age.saturating_record(age);
        }
        for (joint, &latency) in self.joints.iter_mut().zip(&record.reply_latency_ns) {
            if latency > 0 {
                joint.saturating_record(u64::from(latency));
                self.reply.saturating_record(u64::from(latency));
            }
        }
    }

    fn telemetry(&self) -> Telemetry {
        let ran = self.first.map_or(Duration::ZERO, |first| self.last.since(first) + self.period);
        Telemetry {
            seconds: ran.as_secs_f64(),
            wake_latency_us: percentiles(&self.wake),
            reply_latency_us: percentiles(&self.reply),
            setpoint_age_us: percentiles(&self.setpoint_age),
            cycle_us: percentiles(&self.cycle),
            joints: self.joints.iter().map(percentiles).collect(),
            ..self.totals.clone()
        }
    }
}

fn percentiles(histogram: &Histogram<u64>) -> Percentiles {
    let microseconds = |nanos: u64| nanos as f64 / 1000.0;
    Percentiles {
        count: histogram.len(),
        p50: microseconds(histogram.value_at_quantile(0.5)),
        p99: microseconds(histogram.value_at_quantile(0.99)),
        p99_9: microseconds(histogram.value_at_quantile(0.999)),
        max: microseconds(histogram.max()),
    }
}
