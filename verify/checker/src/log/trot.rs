//! In every cycle exactly one control frame to every motor whose turn it is, and at most one question
//! per bus, nothing else; and nearly every tick has its cycle.
//!
//! The first motor of the robot is asked first and in every cycle, so its control frames divide the log
//! into cycles. A motor that takes turns has its turn in the cycles that follow its first control frame
//! by a multiple of its bus's `every`. The trot begins with the first cycle after the last start of a
//! motor in which each without turns has its control frame, because some follow setpoints later than
//! others, and ends with the first stop. A start in its middle makes it too short.

use super::{Command, Kind, Mark, Rules, Verdict, seconds};
use crate::protocol::mit::Meaning;
use crate::robot::{Wired, Wiring};
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
    /// Number of control frames in this cycle, by motor.
    controls: Vec<usize>,
    /// Cycle of the first control frame, by motor.
    first_turns: Vec<Option<usize>>,
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
            first_turns: vec![None; motors],
            polls: BTreeMap::new(),
            polled: 0,
        }
    }

    fn begin_cycle(&mut self, now: Duration, verdict: &mut Verdict) {
        let is_complete =
            |(motor, count): (&Wired, &usize)| if motor.every > 1 { *count <= 1 } else { *count == 1 };
        let has_begun = self.cycles > 0 || self.wiring.motors.iter().zip(&self.controls).all(is_complete);
        let Some((begun, _)) = self.span.filter(|_| has_begun) else {
            self.span = Some((now, now));
            self.controls.fill(0);
            self.polls.clear();
            return;
        };
        self.span = Some((begun, now));
        self.check_controls(now, verdict);
        self.cycles += 1;
        for (bus, polls) in std::mem::take(&mut self.polls) {
            verdict.demand(polls <= 1, || format!("at {} s: {polls} polls on {bus}", seconds(now)));
        }
    }

    /// Checks the number of control frames to each motor in the cycle that ends `now`.
    fn check_controls(&mut self, now: Duration, verdict: &mut Verdict) {
        let firsts = self.first_turns.iter_mut();
        for ((motor, count), first) in self.wiring.motors.iter().zip(&mut self.controls).zip(firsts) {
            let received = std::mem::take(count);
            *first = first.or((received > 0).then_some(self.cycles));
            let is_due = first.map_or(self.cycles + 1 >= motor.every, |first| {
                (self.cycles - first).is_multiple_of(motor.every)
            });
            let complaint = || format!("at {} s: {received} control frames to {}", seconds(now), motor.name);
            verdict.demand(received == usize::from(is_due), complaint);
        }
    }
}

/// Returns `true` for a setpoint of any form, and for a change of its form in place of one.
const fn is_control(command: &Command) -> bool {
    let meaning = command.meaning;
    matches!(
        meaning,
        Some(
            Meaning::Control { .. }
                | Meaning::Torque(_)
                | Meaning::Speed(_)
                | Meaning::Position(_)
                | Meaning::Mode
        )
    )
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
        if command.meaning == Some(Meaning::Start) {
            self.started[motor] = true;
            (self.span, self.cycles) = (None, 0);
            self.first_turns.fill(None);
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

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    const CYCLES: u32 = 100;
    const ODRIVE_TORQUE: &str = "0AE#000000BE00000000";
    const ODRIVE_MODE: &str = "0AB#0100000001000000";

    /// An MIT and a GIM motor on one bus, and an ODrive that takes turns on another.
    fn wiring() -> Wiring {
        Wiring::parse(
            "[[bus]]\nname = \"a\"\ninterface = \"vcan0\"\n[[bus]]\nname = \"b\"\ninterface = \"vcan1\"\nevery = 3\n\
             [[motor]]\nname = \"hip\"\nbus = \"a\"\nid = 1\nprotocol = \"mit\"\nmodel = \"GIM8108-8\"\n\
             [[motor]]\nname = \"thigh\"\nbus = \"a\"\nid = 2\nprotocol = \"gim\"\nmodel = \"GIM8108-8\"\n\
             [[motor]]\nname = \"knee\"\nbus = \"b\"\nid = 5\nprotocol = \"odrive\"\nmodel = \"ODrive-S1\"\n",
        )
        .expect("the text is a robot")
    }

    /// Returns the complaints about a trot at 1 kHz. `sent` returns the frames of a cycle from its good
    /// ones.
    fn complaints(
        sent: impl Fn(u32, Vec<(&'static str, &'static str)>) -> Vec<(&'static str, &'static str)>,
    ) -> String {
        let mut log = String::from(
            "(999.000000) vcan0 001#FFFFFFFFFFFFFFFC\n(999.000000) vcan0 002#9100000000000000\n\
             (999.000000) vcan1 0A7#0800000000000000\n",
        );
        for cycle in 0..CYCLES {
            let mut good = vec![("vcan0", "001#81237FF0A4099812"), ("vcan0", "002#930000003E000000")];
            match cycle % 9 {
                1 | 4 => good.push(("vcan1", ODRIVE_TORQUE)),
                7 => good.push(("vcan1", ODRIVE_MODE)),
                _ => {}
            }
            for (index, (interface, frame)) in sent(cycle, good).into_iter().enumerate() {
                log += &format!("(1000.{cycle:03}{index:03}) {interface} {frame}\n");
            }
        }
        let wiring = wiring();
        let demand = Demand { rate: 1000.0, seconds: 0.19, share: 0.95 };
        check(&mut Trot::new(&wiring, demand), &wiring, &[], &log).complaints.join("\n")
    }

    /// Leaves out or adds this frame in one cycle.
    fn falsified(at: u32, frame: (&'static str, &'static str), adds: bool) -> String {
        complaints(|cycle, mut good| {
            if cycle == at {
                good.retain(|sent| adds || *sent != frame);
                good.extend(adds.then_some(frame));
            }
            good
        })
    }

    #[test]
    fn each_form_of_a_setpoint_counts() {
        assert_eq!(complaints(|_, good| good), "");
        let without = falsified(50, ("vcan0", "002#930000003E000000"), false);
        assert_eq!(without, "at 1000.051000 s: 0 control frames to thigh");
        assert!(complaints(|_, mut good| good.split_off(1)).contains("too few"));
    }

    #[test]
    fn motor_with_turns_gets_one_in_each() {
        for (at, frame) in [(49, ODRIVE_TORQUE), (52, ODRIVE_MODE)] {
            let complaint = format!("at 1000.0{}000 s: 0 control frames to knee", at + 1);
            assert!(falsified(at, ("vcan1", frame), false).starts_with(&complaint), "{at}");
        }
        for (at, number) in [(49, 2), (50, 1), (51, 1)] {
            let complaint = format!("at 1000.0{}000 s: {number} control frames to knee", at + 1);
            assert_eq!(falsified(at, ("vcan1", ODRIVE_TORQUE), true), complaint);
        }
        let silent = complaints(|_, mut good| {
            good.retain(|(bus, _)| *bus == "vcan0");
            good
        });
        assert!(silent.starts_with("at 1000.003000 s: 0 control frames to knee"), "{silent}");
    }

    #[test]
    fn trot_begins_after_the_last_start() {
        let start = ("vcan1", "0A7#0800000000000000");
        let with = |at: u32| {
            complaints(|cycle, mut good| {
                if cycle == at {
                    good.retain(|(bus, _)| *bus == "vcan0");
                    good.push(start);
                }
                good
            })
        };
        assert_eq!(with(1), "");
        assert!(with(49).contains("the trot ended early, after 0.049 s"), "{}", with(49));
    }

    #[test]
    fn other_commands_of_turns_are_not_due() {
        for frame in ["0AB#0000000001000000", "0A7#0300000000000000", "0A2#0000000000000000"] {
            let text = falsified(50, ("vcan1", frame), true);
            assert!(text.contains("to knee was not due"), "{frame}: {text}");
        }
    }
}
