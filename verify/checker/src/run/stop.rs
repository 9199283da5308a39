//! Rules for stops (I10): an injected fault must stop its groups in time, because a motor without
//! commands keeps its last one.

use super::cycle::{Cycle, ReceivedCommand};
use crate::robot::{Motor, Robot, SafeStop};
use crate::state::{Mode, Phase, State};
use std::collections::VecDeque;

/// Most cycles from a fault that the cycle can detect to a safe frame.
const NOTICE_CYCLES: u32 = 2;
/// Further cycles after which a silent motor is detected: replies in flight and fault requests
/// delay the detection.
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

/// The faults that must be detected.
#[derive(Debug, Default)]
pub(super) struct Injections(Vec<Injected>);

impl Injections {
    /// Begins a fault: every active group with this target must be stopped soon.
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

    /// Ends the fault.
    pub(super) fn end(&mut self, target: Target) {
        self.0.retain(|injected| injected.target != target);
    }

    /// Checks the faults after a cycle.
    pub(super) fn check(&mut self, cycle: &Cycle) {
        self.0.retain(|injected| cycle.is(injected.group, Phase::Active));
        for injected in &mut self.0 {
            assert!(injected.cycles_left > 0, "I10: nobody noticed {injected:?}");
            injected.cycles_left -= 1;
        }
    }
}

/// Most cycles by which other traffic and a clock that goes backward delay a frame on a healthy
/// bus.
const DELAY_CYCLES: usize = 3;
/// Turns in which a motor that takes turns receives at least one command. Fault requests take the
/// turns of a silent motor, and a cycle that follows a late one too soon takes another.
const TURNS: u32 = 4;

/// Checks the commands that motors received in the newest cycle whose frames have all left. Checks
/// only motors of a bus that was healthy all the time.
pub(super) fn check(robot: &Robot, cycles: &VecDeque<Cycle>) {
    let Some(checked) = cycles.len().checked_sub(DELAY_CYCLES + 1).filter(|checked| *checked > 0) else {
        return;
    };
    let cycle = &cycles[checked];
    for (group, members) in robot.groups.iter().enumerate() {
        let disarmed = cycle.state.groups[group].phase == Phase::Disarmed;
        let moved = cycle.was(group, Phase::Starting) || cycle.was(group, Phase::Active);
        let may = members.safe_stop == SafeStop::Stop;
        assert!(may || !disarmed || !moved, "I10: a group was stopped without damping");
        for &motor in &members.motors {
            let settings = &robot.motors[motor];
            let memory = if settings.has_turns() { TURNS * settings.turn } else { 1 };
            let first = checked.checked_sub(memory as usize);
            let well_since = first.map(|first| first.min(checked.saturating_sub(DELAY_CYCLES)));
            let is_well = |first: usize| cycles.range(first..).all(|cycle| cycle.well[settings.bus]);
            if let (Some(first), true) = (first, well_since.is_some_and(is_well)) {
                let past = cycles.range(first..checked);
                check_motor(settings, [group, motor], past, cycle);
            }
        }
    }
}

/// `past`: the cycles before `cycle`. Unless it is offline, a motor that takes turns receives a
/// command in one of them or in `cycle`.
fn check_motor<'a>(
    settings: &Motor,
    [group, motor]: [usize; 2],
    past: impl DoubleEndedIterator<Item = &'a Cycle> + Clone,
    cycle: &Cycle,
) {
    let (name, has_turns) = (&settings.name, settings.has_turns());
    let mode = |state: &State| state.joints[motor].mode;
    let offline =
        |cycle: &Cycle| [&cycle.before, &cycle.state].map(|state| mode(state)).contains(&Mode::Offline);
    let received = |cycle: &Cycle| cycle.received[motor].is_some();
    let waits = has_turns && past.clone().any(|cycle| received(cycle) || offline(cycle));
    // A cause that a reply of this cycle gives changes the mode after the command is decided.
    let is_omitted = || {
        matches!(mode(&cycle.before), Mode::Active | Mode::Idle)
            && cycle.before.joints[motor].missed > 0
            && past.clone().next_back().is_some_and(received)
    };
    assert!(offline(cycle) || received(cycle) || waits || is_omitted(), "I10: {name} heard nothing");
    if mode(&cycle.before) != Mode::Damping || !cycle.was(group, Phase::Damping) {
        return;
    }
    // The requests to a motor that takes turns have separate turns.
    let counts = |received: &ReceivedCommand| !has_turns || !received.order.is_question();
    let now = cycle.received[motor].filter(counts);
    let before = past.rev().find_map(|cycle| cycle.received[motor].filter(counts));
    if !cycle.is(group, Phase::Damping) {
        let damped = is_fault_request(before) || is(before, |received| received.brakes && !received.pulls);
        assert!(damped, "I10: {name} heard {before:?} and went limp");
    } else if mode(&cycle.state) == Mode::Damping && (now.is_some() || !has_turns) {
        let asked = is_fault_request(now) && !is_fault_request(before);
        assert!(
            asked || is(now, |received| received.brakes),
            "I10: {name} heard {before:?} and {now:?} while it is damped"
        );
    }
}

fn is(received: Option<ReceivedCommand>, so: impl FnOnce(ReceivedCommand) -> bool) -> bool {
    received.is_some_and(so)
}

fn is_fault_request(received: Option<ReceivedCommand>) -> bool {
    is(received, |received| received.is_fault_request())
}
