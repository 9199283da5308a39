//! Every motor receives damping and then a stop after the death of a process or a thread. From the
//! first damping frame of a bus until the next start, no command on it moves a motor.
//!
//! Marks: `due COUNT DEATH...` gives the expected number of each death, `start` permits starts, and
//! `DEATH` records a death. A process freezes when the kernel next runs one of its threads, so the
//! death `freeze` is counted from the last command that moves.

use super::times::{self, Limits};
use super::{Command, Kind, Mark, Rules, Verdict};
use crate::robot::Wiring;
use motord_bus::Duration;
use std::collections::BTreeMap;

/// Greatest age of the last command that moves, on every bus, when a death happens during the trot.
const TROT: Duration = Duration::from_millis(30);

/// The commands that one motor has received.
#[derive(Debug, Clone, Copy, Default)]
struct MotorProgress {
    /// It has received a command to move, at any time.
    moved: bool,
    /// It was damped since the last mark.
    damped: bool,
    /// It was stopped since the last mark.
    stopped: bool,
}

/// The commands that one interface has carried.
#[derive(Debug, Clone, Copy, Default)]
struct Carried {
    /// The last command that moves.
    motion: Option<Duration>,
    /// It has carried damping since the last death.
    damped: bool,
}

/// The rules.
#[derive(Debug)]
pub struct Deaths<'a> {
    wiring: &'a Wiring,
    limits: &'a Limits,
    /// The current death, and its time.
    death: Option<(String, Duration)>,
    motors: Vec<MotorProgress>,
    buses: BTreeMap<&'a str, Carried>,
    due: BTreeMap<String, usize>,
    repetitions: BTreeMap<String, usize>,
    /// Milliseconds until the first damping frame of each bus.
    times: BTreeMap<String, Vec<f64>>,
}

impl<'a> Deaths<'a> {
    /// Returns the rules before the first event.
    #[must_use]
    pub fn new(wiring: &'a Wiring, limits: &'a Limits) -> Self {
        let buses =
            wiring.interfaces().into_iter().map(|interface| (interface, Carried::default())).collect();
        Self {
            wiring,
            limits,
            death: None,
            motors: vec![MotorProgress::default(); wiring.motors.len()],
            buses,
            due: BTreeMap::new(),
            repetitions: BTreeMap::new(),
            times: BTreeMap::new(),
        }
    }

    fn complain_of(&self, what: &str, verdict: &mut Verdict) {
        let (death, repetition) = match &self.death {
            Some((death, _)) => (death.as_str(), self.repetitions[death]),
            None => ("start", 0),
        };
        verdict.complain(format!("{what} ({death}, repetition {repetition})"));
    }

    /// Checks that every motor that ever moved was damped and stopped.
    fn close(&self, verdict: &mut Verdict) {
        if self.death.is_none() {
            return;
        }
        let moved = || self.motors.iter().zip(&self.wiring.motors).filter(|(received, _)| received.moved);
        for (_, motor) in moved().filter(|(received, _)| !received.damped) {
            self.complain_of(&format!("no damping for {}", motor.address()), verdict);
        }
        for (_, motor) in moved().filter(|(received, _)| !received.stopped) {
            self.complain_of(&format!("no stop for {}", motor.address()), verdict);
        }
    }

    /// Records the first damping frame of a bus after a death.
    fn first_damping(&mut self, interface: &'a str, now: Duration, verdict: &mut Verdict) {
        let Some((death, at)) = self.death.clone() else { return };
        let motion = self.buses[interface].motion;
        if motion.is_none_or(|motion| at.saturating_sub(motion) > TROT) {
            self.complain_of(&format!("the robot did not trot on {interface}"), verdict);
        }
        let from = if death == "freeze" { motion.unwrap_or(at) } else { at };
        let milliseconds = now.saturating_sub(from).as_secs_f64() * 1e3;
        self.times.entry(death).or_default().push(milliseconds);
    }
}

impl Rules for Deaths<'_> {
    fn mark(&mut self, mark: &Mark, verdict: &mut Verdict) {
        if mark.word() == "due" {
            let count = mark.words.get(1).and_then(|count| count.parse().ok()).unwrap_or(0);
            let deaths = mark.words.iter().skip(2);
            self.due.extend(deaths.map(|death| (death.clone(), count * self.buses.len())));
            return;
        }
        self.close(verdict);
        self.motors.iter_mut().for_each(|received| (received.damped, received.stopped) = (false, false));
        self.buses.values_mut().for_each(|bus| bus.damped = false);
        self.death = None;
        if mark.word() != "start" {
            *self.repetitions.entry(mark.word().into()).or_default() += 1;
            self.death = Some((mark.word().into(), mark.at));
        }
    }

    fn command(&mut self, command: &Command, verdict: &mut Verdict) {
        let interface = self.wiring.motors[command.motor].interface.as_str();
        let bus = self.buses[interface];
        match command.kind {
            Kind::Fault => {}
            Kind::Stop => {
                if self.death.is_some() && !self.motors[command.motor].damped {
                    self.complain_of(&format!("{} before damping", command.text), verdict);
                }
                self.motors[command.motor].stopped = true;
            }
            Kind::Damping if self.death.is_none() => {}
            Kind::Damping => {
                self.motors[command.motor].damped = true;
                if !bus.damped {
                    self.first_damping(interface, command.at, verdict);
                }
                self.buses.insert(interface, Carried { damped: true, ..bus });
            }
            Kind::Motion if bus.damped => {
                self.complain_of(&format!("{} after damping", command.text), verdict);
            }
            Kind::Motion => {
                self.motors[command.motor].moved = true;
                self.buses.insert(interface, Carried { motion: Some(command.at), ..bus });
            }
        }
    }

    fn end(&mut self, verdict: &mut Verdict) {
        self.close(verdict);
        for (death, due) in &self.due {
            let checked = self.times.get(death).map_or(0, Vec::len);
            verdict.demand(checked == *due, || format!("{death} was judged {checked} times of {due}"));
        }
        verdict.demand(!self.due.is_empty(), || "no death is due".into());
        let moved = self.motors.iter().filter(|received| received.moved).count();
        let motors = self.motors.len();
        verdict.demand(moved == motors, || format!("{moved} motors of {motors} received commands to move"));
        for (death, times) in std::mem::take(&mut self.times) {
            let (line, in_time) = times::check(&death, times, self.limits);
            verdict.report.push(line);
            verdict.demand(in_time, || format!("{death} is damped too late"));
        }
    }
}
