//! In every cycle exactly one control frame to every motor and at most one question per
//! bus, nothing else; and nearly every tick has its cycle.
//!
//! The first motor of the robot is asked first, so its control frames divide the log into cycles.
//! The trot begins with the first complete cycle after all motors were started, because some follow
//! setpoints later than others, and ends with the first stop.

use super::{Command, Kind, Mark, Rules, Verdict, seconds};
use crate::protocol::mit::Meaning;
use crate::robot::Wiring;
use motord_bus::Duration;
use std::collections::BTreeMap;

/// Demands on a trot.
#[derive(Debug, Clone, Copy)]
pub struct Demand {
    /// Ticks per second.
    pub rate: f64,
    /// How long it is, s.
    pub seconds: f64,
    /// Share of the ticks that have a cycle.
    pub share: f64,
}

/// The rules.
#[derive(Debug)]
pub struct Trot<'a> {
    wiring: &'a Wiring,
    demand: Demand,
    started: Vec<bool>,
    /// The first and the last control frame to the first motor.
    span: Option<(Duration, Duration)>,
    over: bool,
    cycles: usize,
    /// In this cycle.
    controls: Vec<usize>,
    /// In this cycle, by interface.
    polls: BTreeMap<&'a str, usize>,
    polled: usize,
}

impl<'a> Trot<'a> {
    /// Nothing has been heard yet.
    #[must_use]
    pub fn new(wiring: &'a Wiring, demand: Demand) -> Self {
        let motors = wiring.motors.len();
        Self {
            wiring,
            demand,
            started: wiring.motors.iter().map(|motor| !motor.needs_start).collect(),
            span: None,
            over: false,
            cycles: 0,
            controls: vec![0; motors],
            polls: BTreeMap::new(),
            polled: 0,
        }
    }

    fn begin_cycle(&mut self, now: Duration, verdict: &mut Verdict) {
        let has_begun = self.cycles > 0 || self.controls.iter().all(|count| *count == 1);
        let Some((begun, _)) = self.span.filter(|_| has_begun) else {
            self.span = Some((now, now));
            self.controls.fill(0);
            self.polls.clear();
            return;
        };
        self.span = Some((begun, now));
        self.cycles += 1;
        for (motor, count) in self.wiring.motors.iter().zip(&mut self.controls) {
            let received = std::mem::take(count);
            let complaint = || format!("at {} s: {received} control frames to {}", seconds(now), motor.name);
            verdict.demand(received == 1, complaint);
        }
        for (bus, polls) in std::mem::take(&mut self.polls) {
            verdict.demand(polls <= 1, || format!("at {} s: {polls} polls on {bus}", seconds(now)));
        }
    }
}

fn is_control(command: &Command) -> bool {
    matches!(command.meaning, Some(Meaning::Control { .. }))
}

impl Rules for Trot<'_> {
    fn mark(&mut self, _: &Mark, _: &mut Verdict) {}

    fn command(&mut self, command: &Command, verdict: &mut Verdict) {
        let Command { at, motor, .. } = *command;
        let begun = self.span.is_some();
        self.over |= begun && command.kind == Kind::Stop;
        if self.over {
            return;
        }
        if command.meaning == Some(Meaning::Start) && !begun {
            self.started[motor] = true;
            return;
        }
        if self.started.contains(&false) {
            return;
        }
        if motor == 0 && is_control(command) {
            self.begin_cycle(at, verdict);
        }
        if self.span.is_none() {
            return;
        }
        if is_control(command) {
            self.controls[motor] += 1;
        } else if command.meaning.is_some_and(|meaning| meaning.is_question()) {
            *self.polls.entry(&self.wiring.motors[motor].interface).or_default() += 1;
            self.polled += 1;
        } else if self.cycles > 0 {
            let (text, name) = (&command.text, &self.wiring.motors[motor].name);
            verdict.complain(format!("at {} s: {text} to {name} was not due", seconds(at)));
        }
    }

    fn end(&mut self, verdict: &mut Verdict) {
        let Demand { rate, seconds, share } = self.demand;
        let (begun, ended) = self.span.unwrap_or_default();
        let lasted = (ended - begun).as_secs_f64();
        verdict.demand(lasted >= seconds - 0.1, || format!("the trot ended early, after {lasted:.3} s"));
        let ticks = (lasted * rate).round();
        let had = if ticks > 0.0 { self.cycles as f64 / ticks } else { 0.0 };
        let motors = self.started.iter().filter(|started| **started).count();
        let (cycles, polled, all) = (self.cycles, self.polled, self.started.len());
        let percent = 100.0 * had;
        let summary =
            format!("{cycles} cycles of {ticks} ({percent:.1} %), {motors} motors, {polled} questions");
        verdict.demand(motors == all && had >= share, || format!("too few: {summary}"));
        verdict.report.push(summary);
    }
}
