//! Opens buses again that went away, and empties those that are held, in a thread of its own.
//!
//! ```text
//!   telemetry ──bus is gone, stays off, or is held──▶ this thread ──opened bus──▶ cycle
//!                                                         ▲                         │
//!                                                         └────── old bus ──────────┘   (closing it is a system call, too)
//! ```
//!
//! A bus that is back has stopped motors: opening it enables nothing.
//!
//! A held bus has motors that fell silent together. The frames that wait on it are discarded before
//! it is opened again, where motord may take its interface down and up.
//!
//! A serial port is closed before it is opened again: it is locked, and while it is open, the
//! kernel gives another name to the adapter that is plugged in again. The cycle gets an `Unplugged`
//! bus for it meanwhile. It also gets one while another adapter has the name of the bus.
//!
//! A simulated bus is never opened again: it comes back by itself when its fault ends, with the
//! same motors.

use crate::buses::claims::Claims;
use crate::buses::opening::BusError;
use crate::buses::watch::Task;
use motord_bus::transport::Hardware;
use motord_bus::{Bus, Duration, Frame, Inbox, Instant, Readiness, Refusal, Sent};
use motord_core::cycle::Supply;
use motord_settings::settings::Settings;
use motord_shared::BusCondition;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Mutex, Weak};

/// The wait after a failed attempt. It doubles up to [`BACK_OFF_MAX`].
const BACK_OFF: Duration = Duration::from_secs(1);
const BACK_OFF_MAX: Duration = Duration::from_secs(8);

/// The cycle gives an old bus away within this time, as long as it runs.
const HAND_OVER: Duration = Duration::from_millis(100);

/// The wait after the next attempt that fails.
#[derive(Debug)]
struct BackOff(Duration);

impl BackOff {
    /// The wait after an attempt.
    fn after(&mut self, failed: bool) -> Duration {
        let wait = if failed { self.0 } else { BACK_OFF };
        self.0 = if failed { (2 * wait).min(BACK_OFF_MAX) } else { BACK_OFF };
        wait
    }
}

/// A bus whose adapter is not there, or is another one: it takes nothing.
struct Unplugged;

impl Bus for Unplugged {
    /// No system call.
    fn send(&mut self, _now: Instant, frames: &[Frame]) -> Sent {
        Sent { accepted: 0, refusal: (!frames.is_empty()).then_some(Refusal::Gone) }
    }

    /// Nothing ever comes.
    fn receive(&mut self, _now: Instant, _inbox: &mut Inbox) {}

    fn readiness(&self) -> Readiness<'_> {
        Readiness::Never
    }
}

fn is_real(settings: &Settings, bus: usize) -> bool {
    !settings.buses[bus].kind.is_simulated()
}

/// Opens buses again.
pub struct Reconnector {
    supply: Supply,
    claims: Weak<Mutex<Claims>>,
    /// The last failure of each bus, by index: it is logged once.
    failures: BTreeMap<usize, String>,
    /// The buses whose substitute the cycle has since another adapter had their name.
    exchanged: BTreeSet<usize>,
    /// The buses that are opened again because they are held.
    held: BTreeSet<usize>,
}

impl Reconnector {
    /// A reconnector that hands opened buses to `supply`, and locks each in `claims` before it is
    /// opened.
    #[must_use]
    pub const fn new(supply: Supply, claims: Weak<Mutex<Claims>>) -> Self {
        Self { supply, claims, failures: BTreeMap::new(), exchanged: BTreeSet::new(), held: BTreeSet::new() }
    }

    /// Executes the `tasks`, until `stop` returns true. A bus that cannot be opened is tried again
    /// after 1, 2, 4, then every 8 s.
    pub fn run(&mut self, settings: &Settings, tasks: &Receiver<Task>, stop: impl Fn() -> bool) {
        let mut waiting: Vec<usize> = Vec::new();
        let (mut back_off, mut wait) = (BackOff(BACK_OFF), BACK_OFF);
        while !stop() {
            match tasks.recv_timeout(wait) {
                Ok(Task::Open(bus) | Task::Empty(bus))
                    if !is_real(settings, bus) || waiting.contains(&bus) => {}
                Ok(Task::Open(bus)) => {
                    waiting.push(bus);
                    self.close(settings, bus);
                }
                Ok(Task::Empty(bus)) => {
                    self.empty(settings, bus);
                    waiting.push(bus);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            self.supply.close_retired();
            let before = waiting.len();
            waiting.retain(|&bus| !self.reopen(settings, bus));
            let failing = !waiting.is_empty() && waiting.len() == before;
            wait = back_off.after(failing);
        }
    }

    /// Closes a bus that is gone, where it must be closed before it is opened again.
    fn close(&mut self, settings: &Settings, index: usize) {
        let hardware = settings.buses[index].kind.hardware();
        if hardware.is_some_and(Hardware::closes_before_reopening)
            && self.supply.set_aside(index, Box::new(Unplugged), BusCondition::Gone)
        {
            std::thread::sleep(HAND_OVER);
        }
    }

    /// Discards the frames that wait on a held bus.
    fn empty(&mut self, settings: &Settings, index: usize) {
        self.held.insert(index);
        let bus = &settings.buses[index].name;
        match Claims::discard_shared(&self.claims, settings, index) {
            Ok(true) => tracing::warn!(
                bus,
                see = "held",
                "its interface was taken down and up: the frames that kernel and adapter held are discarded"
            ),
            Ok(false) => tracing::info!(bus, "no frame waits on it"),
            Err(error) => tracing::error!(see = "held", "{error}"),
        }
    }

    fn reopen(&mut self, settings: &Settings, index: usize) -> bool {
        let name = &settings.buses[index].name;
        match Claims::reopen_shared(&self.claims, settings, index) {
            Ok(bus) => {
                if !self.held.remove(&index) {
                    tracing::warn!(
                        bus = name,
                        see = "gone",
                        "opened again; motors that were stopped stay stopped until they are enabled"
                    );
                }
                self.failures.remove(&index);
                self.exchanged.remove(&index);
                self.supply.hand_over(index, bus)
            }
            Err(error) => {
                self.fail(index, &error);
                false
            }
        }
    }

    /// Logs a failure that is another one than before. The state shows whether the adapter is
    /// missing or exchanged.
    fn fail(&mut self, index: usize, error: &BusError) {
        let failure = error.to_string();
        if self.failures.get(&index) == Some(&failure) {
            return;
        }
        let (condition, see) = match error {
            BusError::OtherAdapter { .. } => (BusCondition::Exchanged, "exchanged"),
            _ => (BusCondition::Gone, "gone"),
        };
        tracing::warn!(see, "{failure}; trying again");
        self.failures.insert(index, failure);
        if condition == BusCondition::Exchanged || self.exchanged.contains(&index) {
            self.exchanged.insert(index);
            self.supply.set_aside(index, Box::new(Unplugged), condition);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absent_adapter_is_retried_with_growing_delay() {
        let mut back_off = BackOff(BACK_OFF);
        let waits: Vec<u64> = (0..6).map(|_| back_off.after(true).as_secs()).collect();
        assert_eq!(waits, [1, 2, 4, 8, 8, 8]);
        assert_eq!([false, true, true].map(|failed| back_off.after(failed).as_secs()), [1, 1, 2]);
    }
}
