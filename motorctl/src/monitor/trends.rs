//! The last minute of every joint: position, velocity and torque, the applied position, and its
//! stops and faults, in the time of the states.

use motord_client::{JointState, Kind, RobotDescription, State};
use motord_record::{Event, Events, concerns, is_mark};
use std::collections::VecDeque;

/// Position, velocity and torque.
pub(super) const QUANTITIES: usize = 3;
/// Index of the applied position among the values of a joint, after the quantities.
pub(super) const APPLIED: usize = QUANTITIES;
/// Number of values of a joint.
const VALUES: usize = QUANTITIES + 1;
/// Time whose values are merged, ns.
const SLOT_NS: u64 = 50_000_000;
/// Largest number of remembered slots: a minute.
const SLOTS_MAX: usize = 1200;
/// Largest number of remembered marks, one for each letter.
const MARKS_MAX: usize = 26;
/// Longest time between two states that a curve connects, ns.
const GAP_NS: u64 = 2_500_000_000;

/// The lowest and the highest value of a slot; `None` when the motor reported none.
type Extremes = Option<[f32; 2]>;

#[derive(Debug, Clone)]
struct Slot {
    /// Tick of its first state.
    tick_ns: u64,
    joints: Vec<[Extremes; VALUES]>,
}

/// A stop or a fault.
#[derive(Debug, Clone)]
pub(super) struct Mark {
    /// Distinguishes it from the other remembered marks.
    pub(super) letter: char,
    tick_ns: u64,
    event: Event,
}

/// A mark, or a value of a curve: time before the newest state, s, and value.
pub(super) type Point = (f64, f64);

/// The remembered states. The memory has a bound: `SLOTS_MAX` slots of the robot's joints, and
/// `MARKS_MAX` marks.
#[derive(Debug, Default)]
pub(super) struct Trends {
    slots: VecDeque<Slot>,
    marks: VecDeque<Mark>,
    marked: usize,
    events: Events,
    newest_ns: u64,
}

impl Trends {
    /// Adds a state of `robot`. One that is older than the newest begins anew.
    pub(super) fn take(&mut self, state: &State, robot: &RobotDescription) {
        let tick_ns = state.tick_ns();
        if tick_ns < self.newest_ns {
            *self = Self::default();
        }
        self.newest_ns = tick_ns;
        for event in self.events.of(state.message(), robot).into_iter().filter(is_mark) {
            self.mark(tick_ns, event);
        }
        let is_same = |slot: &&mut Slot| slot.tick_ns / SLOT_NS == tick_ns / SLOT_NS;
        match self.slots.back_mut().filter(is_same) {
            Some(slot) => slot.joints.iter_mut().zip(values(state)).for_each(|(slot, new)| merge(slot, new)),
            None => self.slots.push_back(Slot { tick_ns, joints: values(state).collect() }),
        }
        if self.slots.len() > SLOTS_MAX {
            self.slots.pop_front();
        }
    }

    fn mark(&mut self, tick_ns: u64, event: Event) {
        let letter = ('a'..='z').nth(self.marked % MARKS_MAX).unwrap_or('a');
        self.marked += 1;
        self.marks.push_back(Mark { letter, tick_ns, event });
        if self.marks.len() > MARKS_MAX {
            self.marks.pop_front();
        }
    }

    /// Returns a quantity of a joint, or its [`APPLIED`] position, in the last `seconds`, as the
    /// parts between gaps.
    pub(super) fn curve(&self, joint: usize, quantity: usize, seconds: f64) -> Vec<Vec<Point>> {
        let mut parts: Vec<Vec<Point>> = Vec::new();
        let mut before_ns = None;
        for slot in self.slots.iter().filter(|slot| self.time(slot.tick_ns) >= -seconds) {
            let Some([low, high]) = slot.joints.get(joint).and_then(|joint| joint[quantity]) else {
                before_ns = None;
                continue;
            };
            if before_ns.is_none_or(|before| slot.tick_ns.saturating_sub(before) > GAP_NS) {
                parts.push(Vec::new());
            }
            before_ns = Some(slot.tick_ns);
            let time = self.time(slot.tick_ns);
            let part = parts.last_mut().expect("the first value begins a part");
            part.push((time, low.into()));
            if low < high {
                part.push((time, high.into()));
            }
        }
        parts
    }

    /// Returns the marks of `joints` and of their groups in the last `seconds`, the oldest first.
    pub(super) fn marks<'a>(
        &'a self,
        robot: &'a RobotDescription,
        joints: &'a [usize],
        seconds: f64,
    ) -> impl Iterator<Item = (f64, &'a Mark)> {
        let marks = self.marks.iter().map(|mark| (self.time(mark.tick_ns), mark));
        marks.filter(move |(time, mark)| *time >= -seconds && concerns(&mark.event, robot, joints))
    }

    /// Returns the time of a tick after the newest state, s: at most 0.
    fn time(&self, tick_ns: u64) -> f64 {
        -(self.newest_ns.saturating_sub(tick_ns) as f64) / 1e9
    }
}

impl Mark {
    /// Returns the joint or group, and what happened to it.
    pub(super) fn text(&self) -> String {
        self.event.to_string()
    }
}

fn values(state: &State) -> impl Iterator<Item = [Extremes; VALUES]> {
    state.joints().map(|joint| {
        let measured = joint.quantities().map(|(_, value)| value).take(QUANTITIES);
        // Without stiffness the position of a command has no effect.
        let applied = Some(joint.applied.position).filter(|_| joint.applied.kp > 0.0);
        let mut values = measured.chain([applied]).map(|value| value.map(|value| [value, value]));
        std::array::from_fn(|_| values.next().flatten())
    })
}

fn merge(slot: &mut [Extremes; VALUES], new: [Extremes; VALUES]) {
    for (known, new) in slot.iter_mut().zip(new) {
        *known = match (*known, new) {
            (Some([low, high]), Some([lower, higher])) => Some([low.min(lower), high.max(higher)]),
            (known, new) => known.or(new),
        };
    }
}

/// Returns name and unit of the quantities.
pub(super) fn quantities() -> impl Iterator<Item = (&'static str, &'static str)> {
    let measured = JointState::FIELDS.iter().filter(|field| field.kind == Kind::Measured);
    measured.map(|field| (field.name, field.unit)).take(QUANTITIES)
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_client::{Cause, GroupDescription, JointDescription, StateMessage};

    fn robot() -> RobotDescription {
        let joint = JointDescription { name: "knee".to_owned(), ..JointDescription::default() };
        let group = GroupDescription { name: "legs".to_owned(), joints: vec![0] };
        RobotDescription { joints: vec![joint], groups: vec![group], ..RobotDescription::default() }
    }

    fn state(milliseconds: u64, position: Option<f32>, cause: u32) -> State {
        let mut message =
            StateMessage { tick_ns: milliseconds * 1_000_000, joint_count: 1, ..Default::default() };
        message.group_count = 1;
        message.groups[0].cause = cause;
        message.joints[0].flags = if position.is_some() { u32::MAX } else { 0 };
        message.joints[0].position = position.unwrap_or_default();
        State::from(&message)
    }

    #[test]
    fn memory_is_bounded_and_peaks_stay() {
        let (mut trends, robot) = (Trends::default(), robot());
        for milliseconds in (0..200_000).step_by(10) {
            let position = if milliseconds == 190_010 { 9.0 } else { 0.0 };
            let cause = if milliseconds % 100 == 0 { Cause::MotorLost.code() } else { 0 };
            trends.take(&state(milliseconds, Some(position), cause), &robot);
        }
        assert_eq!((trends.slots.len(), trends.marks.len()), (SLOTS_MAX, MARKS_MAX));
        let curve = trends.curve(0, 0, 60.0);
        let peak = curve[0].iter().find(|(_, value)| *value > 8.0).unwrap();
        assert!((-10.1..=-9.9).contains(&peak.0), "{peak:?}");
        let marks: Vec<_> =
            trends.marks(&robot, &[0], 60.0).map(|(_, mark)| (mark.letter, mark.text())).collect();
        let mut letters: Vec<char> = marks.iter().map(|(letter, _)| *letter).collect();
        assert_eq!(marks[0].1, "legs is stopped: motor-lost (knee)");
        letters.sort_unstable();
        letters.dedup();
        assert_eq!(letters.len(), MARKS_MAX);
    }

    #[test]
    fn missing_values_and_missing_time_are_gaps() {
        let (mut trends, robot) = (Trends::default(), robot());
        for milliseconds in (0..12_000).step_by(100) {
            let is_offline = (1000..3000).contains(&milliseconds);
            let is_silent = (5000..9000).contains(&milliseconds);
            if !is_silent {
                trends.take(&state(milliseconds, Some(1.0).filter(|_| !is_offline), 0), &robot);
            }
        }
        assert_eq!(trends.curve(0, 0, 60.0).len(), 3);
        trends.take(&state(0, Some(1.0), 0), &robot);
        assert_eq!(trends.slots.len(), 1, "older than the newest: it begins anew");
    }

    #[test]
    fn applied_position_is_remembered_with_stiffness() {
        let (mut trends, robot) = (Trends::default(), robot());
        for (milliseconds, kp) in [(0, 0.0), (100, 20.0)] {
            let mut message = *state(milliseconds, Some(1.0), 0).message();
            message.joints[0].applied.position = 1.5;
            message.joints[0].applied.kp = kp;
            trends.take(&State::from(&message), &robot);
        }
        assert_eq!(trends.curve(0, 0, 60.0), [vec![(-0.1, 1.0), (0.0, 1.0)]]);
        assert_eq!(trends.curve(0, APPLIED, 60.0), [vec![(0.0, 1.5)]]);
    }
}
