//! Rules for stops (I10): an injected fault must stop its groups in time, because a motor that hears nothing keeps its
//! last command.

use super::cycle::Cycle;
use super::heard::Heard;
use crate::robot::{Robot, SafeStop};
use crate::state::{Mode, Phase, State};

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
            Target::Bus(_) => NOTICE_CYCLES,
            Target::Motor(_) => robot.lost_cycles + SILENCE_CYCLES,
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

/// Judges what the motors heard in `cycle`, which came after `last`, on buses that were well.
pub(super) fn judge(robot: &Robot, last: &Cycle, cycle: &Cycle, is_well: impl Fn(usize) -> bool) {
    for (group, members) in robot.groups.iter().enumerate() {
        let disarmed = cycle.state.groups[group].phase == Phase::Disarmed;
        let moved = cycle.was(group, Phase::Starting) || cycle.was(group, Phase::Active);
        let may = members.safe_stop == SafeStop::Stop;
        assert!(may || !disarmed || !moved, "I10: a group was stopped without damping");
        for &motor in members.motors.iter().filter(|&&motor| is_well(robot.motors[motor].bus)) {
            judge_motor(&robot.motors[motor].name, [last, cycle], group, motor);
        }
    }
}

fn judge_motor(name: &str, [last, cycle]: [&Cycle; 2], group: usize, motor: usize) {
    let [was, mode] = [&cycle.before, &cycle.state].map(|state| state.joints[motor].mode);
    let [before, now] = [last, cycle].map(|cycle| cycle.heard[motor]);
    let (offline, is_same) = ([was, mode].contains(&Mode::Offline), mode == was);
    assert!(offline || now.is_some(), "I10: {name} heard nothing");
    if was != Mode::Damping || !cycle.was(group, Phase::Damping) {
        return;
    }
    if !cycle.is(group, Phase::Damping) {
        let damped = asks_fault(before) || is(before, |heard| heard.brakes && !heard.pulls);
        assert!(damped, "I10: {name} heard {before:?} and went limp");
    } else if is_same {
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
