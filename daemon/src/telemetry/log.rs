//! The events of the cycle as lines of the log. A motor or bus that changes all the time is summed up once a second.

use super::askers::Askers;
use motord_core::control::Event;
use motord_core::cycle::Counters;
use motord_core::settings::Settings;
use motord_protocol::Faults;
use motord_shared::{BusCondition, Cause, MotorMode};
use std::sync::atomic::Ordering;

/// So many changes of one motor or bus in a second get a line each: a start or a stop makes two.
const CHANGES_LOGGED: u32 = 4;

/// Names for the events, and the counts of the last second.
pub(super) struct Log {
    motors: Vec<Subject>,
    groups: Vec<String>,
    buses: Vec<Subject>,
    missed_ticks: u64,
    dropped: u64,
    errors: u64,
}

/// A motor or a bus.
struct Subject {
    name: String,
    changes: u32,
}

impl Subject {
    fn new(name: &str) -> Self {
        Self { name: name.to_owned(), changes: 0 }
    }

    /// Counts a change. Returns whether it gets a line.
    fn changes(&mut self) -> bool {
        self.changes += 1;
        self.changes <= CHANGES_LOGGED
    }

    /// A second is over: sums up the changes that got no line.
    fn summarise(&mut self) {
        let changes = std::mem::take(&mut self.changes);
        if changes > CHANGES_LOGGED {
            tracing::warn!(name = self.name, changes, "changed its state all the time");
        }
    }
}

impl Log {
    pub(super) fn new(settings: &Settings) -> Self {
        Self {
            motors: settings.motors.iter().map(|motor| Subject::new(&motor.name)).collect(),
            groups: settings.groups.iter().map(|group| group.name.clone()).collect(),
            buses: settings.buses.iter().map(|bus| Subject::new(&bus.name)).collect(),
            missed_ticks: 0,
            dropped: 0,
            errors: 0,
        }
    }

    pub(super) fn log(&mut self, cycle: u64, event: Event, askers: &Askers) {
        match event {
            Event::Motor { motor, mode } => self.log_mode(cycle, motor, mode),
            Event::Silent { motor } => tracing::error!(
                cycle,
                motor = self.motors[motor].name,
                "has never answered: check its power and wiring, its id and host id, the bit rate, and that it speaks the \
                 configured protocol"
            ),
            Event::Fault { motor, bits } => self.log_fault(cycle, motor, Faults(bits)),
            Event::Group { group, phase } => {
                tracing::info!(
                    cycle,
                    group = self.groups[group],
                    phase = phase.name(),
                    "{}",
                    phase.sentence()
                );
            }
            Event::Stopped { group, cause, motor, pid } => {
                let process = pid.map(|pid| (pid, askers.program(pid)));
                self.log_stop(cycle, group, cause, motor, process);
            }
            Event::Reset { group } => tracing::info!(cycle, group = self.groups[group], "reset"),
            Event::Owner { group, pid: Some(pid) } => {
                tracing::info!(cycle, group = self.groups[group], pid, "claimed");
            }
            Event::Owner { group, pid: None } => {
                tracing::info!(cycle, group = self.groups[group], "has no owner");
            }
            Event::Bus { bus, condition } => self.log_condition(cycle, bus, condition),
            Event::Overrun { missed_ticks } => self.missed_ticks += missed_ticks,
        }
    }

    fn log_mode(&mut self, cycle: u64, motor: usize, mode: MotorMode) {
        let motor = &mut self.motors[motor];
        if motor.changes() {
            tracing::info!(cycle, motor = motor.name, mode = mode.name(), "{}", mode.sentence());
        }
    }

    fn log_fault(&mut self, cycle: u64, motor: usize, bits: Faults) {
        let motor = &mut self.motors[motor];
        if !motor.changes() {
            return;
        }
        if bits.is_none() {
            return tracing::info!(cycle, motor = motor.name, "no fault any more");
        }
        let sentences: Vec<_> = bits.named().map(|fault| fault.sentence).collect();
        tracing::error!(cycle, motor = motor.name, bits = bits.0, "motor fault: {}", sentences.join(" "));
    }

    fn log_stop(
        &self,
        cycle: u64,
        group: usize,
        cause: Cause,
        motor: Option<usize>,
        process: Option<(u32, String)>,
    ) {
        tracing::error!(
            cycle,
            group = self.groups[group],
            motor = motor.map_or("-", |motor| &self.motors[motor].name),
            pid = process.as_ref().map(|(pid, _)| pid),
            program = process.as_ref().map(|(_, program)| program),
            cause = cause.name(),
            "{} The group is damped and stopped; it stays so until it is reset and enabled.",
            cause.sentence()
        );
    }

    fn log_condition(&mut self, cycle: u64, bus: usize, condition: BusCondition) {
        let bus = &mut self.buses[bus];
        if bus.changes() {
            let condition_name = condition.name();
            tracing::warn!(cycle, bus = bus.name, condition = condition_name, "{}", condition.sentence());
        }
    }

    /// A second is over: logs everything that was only counted.
    pub(super) fn log_counts(&mut self, counters: &Counters) {
        self.motors.iter_mut().chain(&mut self.buses).for_each(Subject::summarise);
        let missed_ticks = std::mem::take(&mut self.missed_ticks);
        if missed_ticks > 0 {
            tracing::warn!(missed_ticks, "ticks were missed: the cycle thread woke up too late");
        }
        let dropped = counters.dropped.load(Ordering::Relaxed);
        if dropped > std::mem::replace(&mut self.dropped, dropped) {
            tracing::warn!(dropped, "telemetry could not keep up: records were dropped");
        }
        let errors = counters.ipc_errors.load(Ordering::Relaxed);
        if errors > std::mem::replace(&mut self.errors, errors) {
            tracing::error!(
                errors,
                "a service for clients failed: are its files damaged, or is the disk full?"
            );
        }
    }
}
