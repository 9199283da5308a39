//! Rules for stops (I10): an injected fault must stop its groups in time, because a motor that hears nothing keeps its
//! last command.

use super::cycle::Cycle;
use super::heard::Heard;
use crate::robot::{Motor, Robot, SafeStop};
use crate::state::{Mode, Phase, State};
use std::collections::VecDeque;

/// A safe frame comes within so many cycles of a fault that the cycle can see.
const NOTICE_CYCLES: u32 = 2;
/// Replies that were under way when a motor fell silent, and questions for its faults, delay the verdict by so many.
const SILENCE_CYCLES: u32 = 4;

/// The part of the robot that a fault was injected into.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Target {
    /// A bus, by its index.
    Bus(usize),
    /// A motor, by its index.
    Motor(usize),
}

/// A fault that was injected while a group was active, and must stop it.
#[derive(Debug)]
pub(super) struct Injected {
    target: Target,
    group: usize,
    cycles_left: u32,
}

/// The faults that must be noticed.
#[derive(Debug, Default)]
pub(super) struct Injections(Vec<Injected>);

impl Injections {
    /// Every active group that `target` is a part of must be stopped soon.
    pub(super) fn begin(&mut self, target: Target, robot: &Robot, state: &State) {
        let is_hurt = |motor: usize| match target {
            Target::Bus(bus) => robot.motors[motor].bus == bus,
            Target::Motor(hurt) => hurt == motor,
        };
        let cycles_left = match target {
            Target::Bus(bus) => NOTICE_CYCLES + robot.turn(bus) - 1,
            Target::Motor(hurt) => (robot.lost_cycles + SILENCE_CYCLES) * robot.motors[hurt].turn,
        };
        for (group, members) in robot.groups.iter().enumerate() {
            let active = state.groups[group].phase == Phase::Active;
            let known = self.0.iter().any(|injected| (injected.target, injected.group) == (target, group));
            if active && !known && members.motors.iter().any(|&motor| is_hurt(motor)) {
                self.0.push(Injected { target, group, cycles_left });
            }
        }
    }

    /// The fault is lifted.
    pub(super) fn end(&mut self, target: Target) {
        self.0.retain(|injected| injected.target != target);
    }

    /// A cycle has passed.
    pub(super) fn judge(&mut self, cycle: &Cycle) {
        self.0.retain(|injected| cycle.is(injected.group, Phase::Active));
        for injected in &mut self.0 {
            assert!(injected.cycles_left > 0, "I10: nobody noticed {injected:?}");
            injected.cycles_left -= 1;
        }
    }
}

/// Other traffic and a clock that goes backward delay no frame by more cycles on a bus that is well.
const DELAY_CYCLES: usize = 3;
/// A motor that takes turns hears a command in one of so many: questions take the turns of one that is silent, and a cycle that
/// follows a late one too soon takes another.
const TURNS: u32 = 4;

/// Judges what motors heard in the newest cycle whose frames have all left. Only motors of a bus that was well all the while are
/// judged.
pub(super) fn judge(robot: &Robot, cycles: &VecDeque<Cycle>) {
    let Some(judged) = cycles.len().checked_sub(DELAY_CYCLES + 1).filter(|judged| *judged > 0) else {
        return;
    };
    let cycle = &cycles[judged];
    for (group, members) in robot.groups.iter().enumerate() {
        let disarmed = cycle.state.groups[group].phase == Phase::Disarmed;
        let moved = cycle.was(group, Phase::Starting) || cycle.was(group, Phase::Active);
        let may = members.safe_stop == SafeStop::Stop;
        assert!(may || !disarmed || !moved, "I10: a group was stopped without damping");
        for &motor in &members.motors {
            let settings = &robot.motors[motor];
            let memory = if settings.takes_turns() { TURNS * settings.turn } else { 1 };
            let first = judged.checked_sub(memory as usize);
            let well_since = first.map(|first| first.min(judged.saturating_sub(DELAY_CYCLES)));
            let is_well = |first: usize| cycles.range(first..).all(|cycle| cycle.well[settings.bus]);
            if let (Some(first), true) = (first, well_since.is_some_and(is_well)) {
                let past = cycles.range(first..judged);
                judge_motor(settings, [group, motor], past, cycle);
            }
        }
    }
}

/// `past`: the cycles before `cycle`. Unless it is offline, a motor that takes turns hears a command in one of them or in `cycle`.
fn judge_motor<'a>(
    settings: &Motor,
    [group, motor]: [usize; 2],
    past: impl DoubleEndedIterator<Item = &'a Cycle> + Clone,
    cycle: &Cycle,
) {
    let (name, takes_turns) = (&settings.name, settings.takes_turns());
    let mode = |state: &State| state.joints[motor].mode;
    let offline =
        |cycle: &Cycle| [&cycle.before, &cycle.state].map(|state| mode(state)).contains(&Mode::Offline);
    let heard = |cycle: &Cycle| cycle.heard[motor].is_some();
    let waits = takes_turns && past.clone().any(|cycle| heard(cycle) || offline(cycle));
    assert!(offline(cycle) || heard(cycle) || waits, "I10: {name} heard nothing");
    if mode(&cycle.before) != Mode::Damping || !cycle.was(group, Phase::Damping) {
        return;
    }
    // The questions to a motor that takes turns have turns of their own.
    let counts = |heard: &Heard| !takes_turns || !heard.order.is_question();
    let now = cycle.heard[motor].filter(counts);
    let before = past.rev().find_map(|cycle| cycle.heard[motor].filter(counts));
    if !cycle.is(group, Phase::Damping) {
        let damped = asks_fault(before) || is(before, |heard| heard.brakes && !heard.pulls);
        assert!(damped, "I10: {name} heard {before:?} and went limp");
    } else if mode(&cycle.state) == Mode::Damping && (now.is_some() || !takes_turns) {
        let asked = asks_fault(now) && !asks_fault(before);
        assert!(
            asked || is(now, |heard| heard.brakes),
            "I10: {name} heard {before:?} and {now:?} while it is damped"
        );
    }
}

fn is(heard: Option<Heard>, so: impl FnOnce(Heard) -> bool) -> bool {
    heard.is_some_and(so)
}

fn asks_fault(heard: Option<Heard>) -> bool {
    is(heard, |heard| heard.asks_fault())
}
