//! No motor receives a start, a stiffness or a torque from shortly after a stop until its reset.
//! Every motor receives some command in this time.
//!
//! Marks: `stop [INTERFACE]` records a stop, and the interface that is down from then on; `reset`.

use super::{Command, Kind, Mark, Rules, Verdict, seconds};
use crate::robot::Wiring;
use motord_bus::Duration;

/// Demands on the stops of a log.
#[derive(Debug, Clone)]
pub struct Demand {
    /// Time from a stop to the first command that must be harmless: the daemon must detect the
    /// stop, and frames are in flight.
    pub notice: Duration,
    /// Stops in the log.
    pub stops: usize,
    /// Interfaces of motors whose owner may reset a stop without a mark. They may receive any
    /// command.
    pub others: Vec<String>,
}

/// A stop that has not been reset.
#[derive(Debug)]
struct Stop {
    at: Duration,
    /// The interface that is down.
    down: Option<String>,
    /// Number of frames by motor since the stop was detected.
    received: Vec<usize>,
    /// A motor was damped.
    damped: bool,
}

/// The rules.
#[derive(Debug)]
pub struct Disturbances<'a> {
    wiring: &'a Wiring,
    demand: Demand,
    stop: Option<Stop>,
    /// By motor: the log contains a command to it.
    seen: Vec<bool>,
    stops: usize,
    checked: usize,
    /// Motors that received no command after a stop, with the time of the stop.
    silent: Vec<(Duration, usize)>,
}

impl<'a> Disturbances<'a> {
    /// Returns the rules before the first event.
    #[must_use]
    pub fn new(wiring: &'a Wiring, demand: Demand) -> Self {
        let seen = vec![false; wiring.motors.len()];
        Self { wiring, demand, stop: None, seen, stops: 0, checked: 0, silent: Vec::new() }
    }

    /// Returns `true` when the command may move its motor: the motor is one of `others`, and the
    /// frame has eight bytes.
    fn may_move(&self, command: &Command) -> bool {
        let is_others = self.demand.others.contains(&self.wiring.motors[command.motor].interface);
        is_others && command.meaning.is_some()
    }

    fn close(&mut self, verdict: &mut Verdict) {
        let Some(stop) = self.stop.take() else { return };
        self.stops += 1;
        for (index, motor) in self.wiring.motors.iter().enumerate() {
            if stop.received[index] == 0 && stop.down.as_ref() != Some(&motor.interface) {
                self.silent.push((stop.at, index));
            }
        }
        self.checked += stop.received.iter().sum::<usize>();
        // Motors that do not answer receive only stops.
        if stop.down.is_some() && !stop.damped {
            verdict.complain(format!("nothing was damped after the stop at {}", seconds(stop.at)));
        }
    }
}

impl Rules for Disturbances<'_> {
    fn mark(&mut self, mark: &Mark, verdict: &mut Verdict) {
        self.close(verdict);
        if mark.word() == "stop" {
            let received = vec![0; self.wiring.motors.len()];
            self.stop = Some(Stop { at: mark.at, down: mark.words.get(1).cloned(), received, damped: false });
        }
    }

    fn command(&mut self, command: &Command, verdict: &mut Verdict) {
        self.seen[command.motor] = true;
        let may_move = self.may_move(command);
        let Some(stop) = &mut self.stop else { return };
        let is_down = stop.down.as_ref() == Some(&self.wiring.motors[command.motor].interface);
        if is_down || command.at < stop.at + self.demand.notice {
            return;
        }
        stop.received[command.motor] += 1;
        match command.kind {
            Kind::Damping => stop.damped = true,
            Kind::Stop | Kind::Fault => {}
            Kind::Motion if may_move => {}
            Kind::Motion => {
                verdict.complain(format!("{} after the stop at {}", command.text, seconds(stop.at)));
            }
        }
    }

    fn end(&mut self, verdict: &mut Verdict) {
        self.close(verdict);
        for (at, motor) in &self.silent {
            let address = self.wiring.motors[*motor].address();
            verdict.complain(format!("{address} heard nothing after the stop at {}", seconds(*at)));
        }
        let Self { stops, checked, .. } = *self;
        let motors = self.seen.iter().filter(|seen| **seen).count();
        let summary =
            format!("{stops} stops, {motors} motors, {checked} frames to them from a stop to its reset");
        let complete = stops == self.demand.stops && motors == self.seen.len();
        verdict.demand(complete, || {
            format!("{stops} stops of {}, {motors} motors of {}", self.demand.stops, self.seen.len())
        });
        verdict.report.push(summary);
    }
}
